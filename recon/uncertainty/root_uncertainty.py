"""Uncertainty of total length, tips and mean diameter: the roots are rendered, and compared with the pictures.

The rendered and the measured coverage are both thinned to lines. Missing roots make the line in the measured picture
longer, surplus roots make it shorter; tips are the ends of lines, and covered area divided by line length is width.
Roots hide each other in both pictures alike, so that the comparison needs no tree. Roots that share a path appear as
one line, and are taken from the roots alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import convolve
from skimage.morphology import skeletonize

from rhizotwin.recon.coverage.silhouettes import Silhouette
from rhizotwin.recon.device import numbers
from rhizotwin.recon.optics import projection
from rhizotwin.recon.optics.projection import ViewBank
from rhizotwin.recon.settings import TrustSettings
from rhizotwin.recon.uncertainty import checks
from rhizotwin.recon.uncertainty.budget import NINETY
from rhizotwin.recon.uncertainty.checks import Estimate
from rhizotwin.scenes import polyline, rsml
from rhizotwin.scenes.rsml import Root
from rhizotwin.scenes.traced_roots import merge_shared_stretches

Array = NDArray[np.float64]
Fixed = NDArray[np.int32]
"""Positions and sizes in fractions of pixels, as used by OpenCV's drawing functions."""

VIEWS = 16
"""Number of pictures that are compared; carving orders them so that neighbours are spread over the turn. More pictures
change the means by less than their standard error."""
_FINER = 4
"""Subdivision of a pixel's edge for drawing roots."""
_SHIFT = 4
"""Fractional bits of OpenCV's drawing coordinates: a sixteenth."""
_LEAST_PX = 1e-6
"""Minimum length of a segment in a picture; shorter ones have no direction."""
_SMOOTH_PX = 0.8
"""Standard deviation of the smoothing of both pictures, so that the lens's own blur (about a pixel) has little
effect."""
_LINE = 0.2
"""Minimum smoothed coverage of a line: a root half a pixel wide has 0.24."""
_MODEL = {"length": 0.02, "tips": 0.07, "diameter": 0.03}
"""90 % half-widths of errors that the comparison does not show: lines beginning inside thick parents, undulation along
the line of sight, ends between pixels. Length (1.6 %) and tips (5 %) of nine in ten clean radishes of the ladder are
within them (docs/accuracy.md), and so is the width of the scans in docs/log/2026-11-22-families.md."""
_THIN_PX, _MUCH_THIN = 0.5, 0.15
"""Width in pixels below which a root is hardly above noise, and maximum fraction of the length below it; with more,
further roots may be missing. Scans with at most 3 % had length errors within 2 %, one with 47 % lost a fifth, one with
54 % a half (docs/log/2026-11-22-families.md)."""
_LEVEL = np.pi / 2.0
"""Factor for level roots: over a turn, their line in the picture has on average 2 / pi of their length, so that missing
or surplus length may be this much larger."""
WIDEST = TrustSettings.widest
"""Maximum relative half-width of an interval for a trusted number: the default of the volume, whatever its setting."""
LEAST_VIEWS = 4
"""Minimum number of pictures that show the roots, to estimate the scatter."""


@dataclass(frozen=True)
class _Measures:
    """Measures of one picture: length of line, number of line ends, and covered area, in pixels."""

    line: float
    ends: float
    area: float


def estimates(
    roots: Sequence[Root], bank: ViewBank, silhouettes: Sequence[Silhouette], *, mu_per_mm: float | None, lost: Sequence[str]
) -> tuple[Estimate, ...]:
    """Compare roots with the pictures.

    Parameters
    ----------
    roots : sequence of Root
        Reconstructed roots; without roots there is no estimate.
    bank, silhouettes : ViewBank, (V,) Silhouette
        All views, neighbours spread over the turn.
    mu_per_mm : float or None
        Attenuation of the roots; None for opaque roots.
    lost : sequence of str
        Reasons for which the scan as a whole is not trusted; empty if it is.

    Returns
    -------
    tuple of Estimate
        Estimates of length, tips and mean diameter.
    """
    if not roots:
        return ()
    count = min(VIEWS, bank.count)
    seen_at = _Places.project(roots, bank.select(range(count)))
    drawn = _draw(seen_at, silhouettes[:count], mu_per_mm)
    thin = seen_at.thin_share()
    if thin > _MUCH_THIN:
        few = f"{100.0 * thin:.0f} % of the length is thinner than half a pixel, and more may be missing (use a higher resolution)"
        lost = (*lost, few)
    pairs = [(_measure(s.coverage, s.usable), _measure(picture, s.usable)) for s, picture in zip(silhouettes[:count], drawn, strict=True)]
    pairs = [(taken, made) for taken, made in pairs if made.line > 0.0 and made.ends > 0.0 and taken.line > 0.0]
    length_mm = rsml.length_mm(roots)
    shared = length_mm - rsml.length_mm(merge_shared_stretches(roots)[0])
    diameter_mm = float(sum(_mean(root) for root in roots)) / max(length_mm, 1e-9)
    tips = float(sum(root.tip_seen for root in roots))
    by_line = [_LEVEL * (taken.line / made.line - 1.0) for taken, made in pairs]
    # One end is the base of the root system.
    by_end = [(taken.ends - made.ends) / max(made.ends - 1.0, 1.0) for taken, made in pairs]
    by_width = [(taken.area / taken.line) / (made.area / made.line) - 1.0 for taken, made in pairs if made.area > 0.0]
    return (
        _estimate("total_length_mm", length_mm, by_line, _MODEL["length"], lost, surplus=shared / max(length_mm, 1e-9)),
        _estimate("tips", tips, by_end, _MODEL["tips"], lost),
        _estimate("mean_diameter_mm", diameter_mm, by_width, _MODEL["diameter"], lost),
    )


def _estimate(name: str, value: float, changes: Sequence[float], model: float, lost: Sequence[str], *, surplus: float = 0.0) -> Estimate:
    """Convert relative changes per picture to an interval: mean on its side, scatter and model error on both."""
    mean = float(np.mean(changes)) if changes else 0.0
    scatter = NINETY * float(np.std(changes, ddof=1)) / len(changes) ** 0.5 if len(changes) >= LEAST_VIEWS else WIDEST
    less = float(np.hypot(np.hypot(scatter, model), max(0.0, -mean) + surplus))
    more = float(np.hypot(np.hypot(scatter, model), max(0.0, mean)))
    reasons = list(lost)
    if max(less, more) > WIDEST:
        reasons.append(
            f"the pictures show {100.0 * abs(mean):.0f} % {'more' if mean > 0.0 else 'less'} than the reconstructed roots"
            if abs(mean) > scatter
            else f"the pictures disagree by {100.0 * scatter:.0f} %"
        )
    low, high = max(0.0, value * (1.0 - less)), value * (1.0 + more)
    words = _WORDS[name]
    verdict = f"{words} not reliable: {'; '.join(reasons)}" if reasons else f"{words} between {low:.3g} and {high:.3g} with 90 % confidence"
    return Estimate(name=name, value=value, interval=(low, high), trusted=not reasons, verdict=verdict.removeprefix(checks.NO_VOLUME))


_WORDS = {
    "total_length_mm": "the total length (mm) is",
    "tips": "the number of tips is",
    "mean_diameter_mm": "the mean diameter (mm) is",
}


def _mean(root: Root) -> float:
    """Return a root's length times its mean diameter."""
    steps = polyline.steps_mm(root.points_mm)
    return float(steps @ (root.diameters_mm[:-1] + root.diameters_mm[1:]) / 2.0)


def _measure(picture: NDArray[np.float32], usable: NDArray[np.bool_]) -> _Measures:
    """Measure skeleton length, number of tips and area in a coverage image (H, W), within usable pixels."""
    smooth = cv2.GaussianBlur(np.where(usable, picture, 0.0).astype(np.float32), (0, 0), _SMOOTH_PX)
    mask = (smooth > _LINE) & usable
    line = skeletonize(mask)
    neighbours = convolve(line.astype(np.uint8), np.ones((3, 3), np.uint8), mode="constant") - line
    return _Measures(float(line.sum()), float((line & (neighbours == 1)).sum()), float(smooth[mask].sum()))


@dataclass(frozen=True)
class _Places:
    """Projections of the roots' nodes into pictures."""

    radius_mm: Array
    """(N,)"""
    step_mm: Array
    """(N,) distance from each node to the next of its root; 0 at the last node of a root."""
    px: Array
    """(V, N, 2)"""
    gradient: Array
    """(V, N, 2, 3) gradients of columns and rows by the point, px/mm."""
    visible: NDArray[np.bool_]
    """(V, N)"""

    @staticmethod
    def project(roots: Sequence[Root], bank: ViewBank) -> _Places:
        """Project roots into all views."""
        points = np.concatenate([root.points_mm for root in roots])
        step = np.concatenate([[*polyline.steps_mm(root.points_mm), 0.0] for root in roots])
        view = dr.repeat(dr.arange(mi.UInt32, bank.count), len(points))
        at = projection.project(bank, view, mi.Point3f(*(dr.tile(numbers(part), bank.count) for part in points.T)), mi.Bool(True))
        shape = (bank.count, len(points))
        px = np.stack([np.array(at.px.x).reshape(shape), np.array(at.px.y).reshape(shape)], axis=-1)
        gradient = np.stack([np.moveaxis(np.array(part).reshape(3, *shape), 0, -1) for part in (at.du, at.dv)], axis=-2)
        radius = np.concatenate([root.diameters_mm for root in roots]) / 2.0
        return _Places(radius, step, px, gradient, np.array(at.visible).reshape(shape))

    def thin_share(self) -> float:
        """Return the fraction of the length that is thinner than `_THIN_PX`."""
        scale = float(np.median(np.linalg.norm(self.gradient, axis=-1)[self.visible])) if self.visible.any() else 0.0
        return float(self.step_mm[2.0 * self.radius_mm * scale < _THIN_PX].sum()) / max(float(self.step_mm.sum()), 1e-9)

    def pieces(self, view: int, first: NDArray[np.int64]) -> tuple[NDArray[np.int64], Fixed, Fixed, Fixed]:
        """Return segments of tubes from nodes (M,) to the next of their root, in OpenCV's drawing coordinates.

        Returns
        -------
        first : (K,) int64 array
            Start nodes of the segments that have a length in the picture.
        corners, end, radius : (K, 4, 2), (K, 2), (K,) int32 array
            Corners of their sides, and rounded ends.
        """
        step = self.px[view, first + 1] - self.px[view, first]
        size = np.hypot(*step.T)
        first, step, size = (part[size >= _LEAST_PX] for part in (first, step, size))
        across, last = np.stack([-step[:, 1], step[:, 0]], axis=1) / size[:, None], first + 1
        begin, end = self.px[view, first], self.px[view, last]
        gradient = (np.einsum("mi,mij->mj", across, self.gradient[view, at]) for at in (first, last))
        half = [self.radius_mm[at] * np.linalg.norm(way, axis=1) for at, way in zip((first, last), gradient, strict=True)]  # of a sphere
        to_side, to_other = (wide[:, None] * across for wide in half)
        corners = np.stack([begin + to_side, end + to_other, end - to_other, begin - to_side], axis=1)
        return first, _to_fixed_point(corners), _to_fixed_point(end), np.rint(half[1] * _FINER * 2**_SHIFT).astype(np.int32)


def _draw(at: _Places, silhouettes: Sequence[Silhouette], mu_per_mm: float | None) -> list[NDArray[np.float32]]:
    """Render roots in views: as filled segments of tubes, with the opacity of their mean chord."""
    dark = np.ones(len(at.radius_mm)) if mu_per_mm is None else -np.expm1(-mu_per_mm * np.pi / 2.0 * at.radius_mm)
    pictures = []
    for k, silhouette in enumerate(silhouettes):
        height, width = silhouette.coverage.shape
        canvas = np.zeros((height * _FINER, width * _FINER), np.float32)
        use = at.visible[k, :-1] & at.visible[k, 1:] & (at.step_mm[:-1] > 0.0)
        order = np.argsort(dark[:-1], kind="stable")  # darkest last
        first, sides, ends, radii = at.pieces(k, order[use[order]])
        for corners, end, radius, shade in zip(sides, ends.tolist(), radii.tolist(), dark[first].tolist(), strict=True):
            cv2.fillConvexPoly(canvas, corners, shade, lineType=cv2.LINE_8, shift=_SHIFT)
            cv2.circle(canvas, end, radius, shade, thickness=-1, shift=_SHIFT)
        pictures.append(cv2.resize(canvas, (width, height), interpolation=cv2.INTER_AREA))
    return pictures


def _to_fixed_point(px: Array) -> Fixed:
    """Convert pixels, whose centres are at integers, to OpenCV's drawing coordinates."""
    return np.rint(((px + 0.5) * _FINER - 0.5) * 2**_SHIFT).astype(np.int32)
