"""Uncertainty of total length, tips and mean diameter, from a comparison of the rendered roots with the pictures.

Coverage in a picture that is far from all rendered roots, thinned to lines, is missing length, and each connected line
a missing root with its tip. Centre lines and tips of roots without coverage nearby are surplus. The covered area
divided by the length of lines is the width. Roots that share a path appear as one line in all pictures; their shared
length is taken from the roots.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray
from skimage.measure import label
from skimage.morphology import skeletonize

from rhizotwin.recon.coverage.silhouettes import Silhouette
from rhizotwin.recon.device import numbers
from rhizotwin.recon.optics import projection
from rhizotwin.recon.optics.projection import ViewBank
from rhizotwin.recon.settings import TrustSettings
from rhizotwin.recon.uncertainty import checks
from rhizotwin.recon.uncertainty.budget import NINETY
from rhizotwin.recon.uncertainty.calibration import NOT_CALIBRATED, Calibration
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
_PEN_PX = 0.5 / _FINER
"""Width that OpenCV adds to each side of a filled polygon: it fills every pixel that its edge touches."""
_LEAST_PX = 1e-6
"""Minimum length of a segment in a picture; shorter ones have no direction."""
_SMOOTH_PX = 0.8
"""Standard deviation of the smoothing of both pictures, so that the lens's own blur (about a pixel) has little
effect."""
_LINE = 0.2
"""Minimum smoothed coverage of a line: a root half a pixel wide has 0.24."""
_FAINT = 0.05
"""Minimum smoothed coverage of a rendered root for pixels nearby to be explained by it."""
_NEAR = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (5, 5))
"""Neighbourhood of two pixels, within which lines are compared: smoothing moves the edge of a line by about one."""
_SHORT_PX = 3
"""Minimum length of a missing root: shorter lines are noise, or the rim of a root whose radius is too small."""
_LEAST_FREE = 0.1
"""Minimum fraction of the root zone outside the roots, for the correction of missing roots for hidden ones."""
_MODEL = {"total_length_mm": 0.035, "tips": 0.1, "mean_diameter_mm": 0.03}
"""Relative 90 % half-widths of errors that the comparison does not show: lines that begin inside thick parents,
undulation along the line of sight, and ends between pixels. They hold for nine in ten random scans in which the
pictures show no difference (docs/intervals.md)."""
_THIN_PX, _MUCH_THIN = 0.5, 0.15
"""Width in pixels below which a root is hardly above noise, and maximum fraction of the length below it; with more,
further roots may be missing. Scans with at most 3 % had length errors within 2 %, one with 47 % lost a fifth, one with
54 % a half (docs/log/2026-11-22-families.md)."""
_LEVEL = np.pi / 2.0
"""Factor for horizontal roots: over a turn, their line in the picture has on average 2 / pi of their length, so that
missing or surplus length may be this much larger."""
_CROWDED, _SEPARABLE = 20.0, 0.005
"""Two numbers for roots that are merged into thicker ones, where many overlap in few views: the relative length and
volume for an overlap of 1 per view, and the overlap per view up to which all roots are separated. In random scans with
12 to 60 views (docs/intervals.md), a radish had 7, 16 and 11 % too much volume, and 16, 31 and 22 % too little length,
at 0.011, 0.016 and 0.017 per view. At 0.0044, length and volume were right to 1 and 4 %."""
WIDEST = TrustSettings.widest
"""Maximum relative half-width of an interval for a trusted number: the default of the volume, whatever its setting."""
LEAST_VIEWS = 4
"""Minimum number of pictures that show the roots, to estimate the scatter."""


@dataclass(frozen=True)
class _Residual:
    """Differences between one picture and the rendered roots, relative to the rendered roots."""

    missing: float
    """Length of missing lines relative to the length of the rendered centre lines."""
    surplus: float
    """Fraction of the rendered centre lines without coverage nearby."""
    missing_tips: float
    """Number of missing roots relative to the number of visible tips."""
    surplus_tips: float
    """Fraction of the visible tips without coverage nearby."""
    width: float
    """Relative excess of the mean width in the picture."""
    overlap: float
    """Length of the projected centre lines relative to the length that is visible, minus 1."""


def estimates(
    roots: Sequence[Root],
    bank: ViewBank,
    silhouettes: Sequence[Silhouette],
    *,
    mu_per_mm: float | None,
    lost: Sequence[str],
    calibration: Calibration = NOT_CALIBRATED,
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
    calibration : Calibration, optional
        Calibration of the scan's intervals.

    Returns
    -------
    tuple of Estimate
        Estimates of length, tips and mean diameter.
    """
    if not roots:
        return ()
    count = min(VIEWS, bank.count)
    places = _Places.project(roots, bank.select(range(count)))
    drawn = _draw(places, silhouettes[:count], mu_per_mm)
    thin = places.thin_share()
    if thin > _MUCH_THIN:
        few = f"{100.0 * thin:.0f} % of the length is thinner than half a pixel, and more may be missing (use a higher resolution)"
        lost = (*lost, few)
    views = [_compare(s, picture, places, k) for k, (s, picture) in enumerate(zip(silhouettes[:count], drawn, strict=True))]
    residuals = [view for view in views if view is not None]
    length_mm = rsml.length_mm(roots)
    shared = (length_mm - rsml.length_mm(merge_shared_stretches(roots)[0])) / max(length_mm, 1e-9)
    tips = float(sum(root.tip_seen for root in roots))
    width = [view.width for view in residuals]
    merged = _merged([view.overlap for view in residuals], bank.count)
    changes = {
        "total_length_mm": (
            length_mm,
            _Change([_LEVEL * view.surplus + shared for view in residuals], [_LEVEL * view.missing + merged for view in residuals]),
        ),
        "tips": (tips, _Change([view.surplus_tips for view in residuals], [view.missing_tips + merged for view in residuals])),
        "mean_diameter_mm": (
            rsml.mean_diameter_mm(roots),
            _Change([max(0.0, -_mean_of(width)) + merged], [max(0.0, _mean_of(width))], width),
        ),
    }
    return tuple(_estimate(name, value, change, lost, calibration.factor(name)) for name, (value, change) in changes.items())


def merged_share(roots: Sequence[Root], bank: ViewBank, shape: tuple[int, ...]) -> float:
    """Return the fraction of the roots that may be merged into thicker ones, for pictures of a shape (H, W)."""
    if not roots:
        return 0.0
    places = _Places.project(roots, bank.select(range(min(VIEWS, bank.count))))
    lines = [places.centre_lines(view, shape) for view in range(len(places.px))]
    return _merged([_overlap(mask, length_px) for mask, length_px in lines], bank.count)


def _merged(overlaps: Sequence[float], views: int) -> float:
    return _CROWDED * max(0.0, _mean_of(overlaps) / views - _SEPARABLE)


def _overlap(lines: NDArray[np.bool_], length_px: float) -> float:
    """Return the length of all centre lines relative to that of the pixels (H, W) on them, minus 1."""
    return max(0.0, length_px / max(float(lines.sum()), 1.0) - 1.0)


def _mean_of(values: Sequence[float]) -> float:
    return float(np.mean(values)) if len(values) else 0.0


@dataclass(frozen=True)
class _Change:
    """Relative changes of a trait that the pictures suggest."""

    less: Sequence[float]
    """Amount by which the trait may be smaller, by picture."""
    more: Sequence[float]
    """Amount by which the trait may be larger, by picture."""
    scatter: Sequence[float] | None = None
    """Changes whose standard error is used; ``more`` minus ``less`` for None."""

    @property
    def error(self) -> float:
        """90 % half-width of the mean change."""
        changes = np.subtract(self.more, self.less) if self.scatter is None else np.asarray(self.scatter)
        return NINETY * float(np.std(changes, ddof=1)) / len(changes) ** 0.5 if len(changes) >= LEAST_VIEWS else WIDEST


def _estimate(name: str, value: float, change: _Change, lost: Sequence[str], factor: float) -> Estimate:
    """Convert relative changes in each picture to an interval: means on their sides, scatter and model error on both.

    Parameters
    ----------
    name : str
        Name of the trait.
    value : float
        Value of the trait.
    change : _Change
        Changes that the pictures suggest.
    lost : sequence of str
        Reasons for which the scan as a whole is not trusted.
    factor : float
        Factor of the calibration on both half-widths.
    """
    error = change.error
    under, over = _mean_of(change.less), _mean_of(change.more)
    less, more = (factor * math.hypot(error, _MODEL[name], side) for side in (under, over))
    low, high = max(0.0, value * (1.0 - less)), value * (1.0 + more)
    reasons = list(lost)
    if max(less, more) > WIDEST:
        worst = max(under, over)
        reasons.append(
            f"the pictures show {100.0 * worst:.0f} % {'more' if over > under else 'less'} than the reconstructed roots"
            if worst > error
            else f"the pictures disagree by {100.0 * error:.0f} %"
        )
    words = _WORDS[name]
    verdict = f"{words} not reliable: {'; '.join(reasons)}" if reasons else f"{words} between {low:.3g} and {high:.3g} with 90 % confidence"
    return Estimate(name=name, value=value, interval=(low, high), trusted=not reasons, verdict=verdict.removeprefix(checks.NO_VOLUME))


_WORDS = {
    "total_length_mm": "the total length (mm) is",
    "tips": "the number of tips is",
    "mean_diameter_mm": "the mean diameter (mm) is",
}


def _compare(silhouette: Silhouette, drawn: NDArray[np.float32], places: _Places, view: int) -> _Residual | None:
    """Compare a picture with the rendered roots, within usable pixels; None if the picture shows no rendered root.

    Parameters
    ----------
    silhouette : Silhouette
        Measured coverage (H, W).
    drawn : (H, W) float32 array
        Coverage by the rendered roots.
    places : _Places
        Projections of the nodes.
    view : int
        Index of the view.
    """
    usable = silhouette.usable
    found, made = (
        cv2.GaussianBlur(np.where(usable, picture, 0.0).astype(np.float32), (0, 0), _SMOOTH_PX) for picture in (silhouette.coverage, drawn)
    )
    covered = (found > _LINE) & usable
    (lines, length_px), tips = places.centre_lines(view, usable.shape), places.tips(view, usable)
    centres = lines & usable
    line = float(centres.sum())
    if not line or not covered.any():
        return None
    beside_picture, beside_roots = (~_dilate(mask) for mask in (covered, made > _FAINT))
    pieces = label(skeletonize(covered & beside_roots), connectivity=2)
    sizes = np.bincount(pieces.ravel())[1:]
    sizes = sizes[sizes >= _SHORT_PX]
    rows, columns = np.nonzero(covered)
    zone = np.s_[rows.min() : rows.max() + 1, columns.min() : columns.max() + 1]
    free = max(float(beside_roots[zone].mean()), _LEAST_FREE)
    missing, surplus = float(sizes.sum()) / free / line, float((centres & beside_picture).sum()) / line
    area = float(found[usable].sum()) / max(float(made[usable].sum()), 1e-9)
    return _Residual(
        missing=missing,
        surplus=surplus,
        missing_tips=len(sizes) / free / max(len(tips), 1),
        surplus_tips=float(beside_picture[tips[:, 1], tips[:, 0]].mean()) if len(tips) else 0.0,
        width=area / max(1.0 + missing - surplus, 1e-9) - 1.0,
        overlap=_overlap(lines, length_px),
    )


def _dilate(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the pixels within two of a mask (H, W)."""
    return np.asarray(cv2.dilate(mask.astype(np.uint8), _NEAR) > 0)


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
    tip: NDArray[np.bool_]
    """(N,) last nodes of roots whose tip is visible in the pictures."""

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
        tip = np.concatenate([(np.arange(len(root.points_mm)) == len(root.points_mm) - 1) & root.tip_seen for root in roots])
        return _Places(radius, step, px, gradient, np.array(at.visible).reshape(shape), tip)

    def segments(self, view: int) -> NDArray[np.bool_]:
        """Return the mask (N - 1,) of nodes that are visible together with the next node of their root."""
        return self.visible[view, :-1] & self.visible[view, 1:] & (self.step_mm[:-1] > 0.0)

    def centre_lines(self, view: int, shape: tuple[int, ...]) -> tuple[NDArray[np.bool_], float]:
        """Return the mask (H, W) of the pixels on centre lines, and the sum of the lengths of all lines in pixels."""
        canvas, at = np.zeros(shape, np.uint8), np.rint(self.px[view]).astype(np.int32)
        first = np.flatnonzero(self.segments(view))
        ends = np.stack([at[first], at[first + 1]], axis=1)
        cv2.polylines(canvas, list(ends), False, 1, lineType=cv2.LINE_8)
        return canvas > 0, float(np.abs(ends[:, 1] - ends[:, 0]).max(axis=1, initial=0).sum())

    def tips(self, view: int, usable: NDArray[np.bool_]) -> NDArray[np.int64]:
        """Return the columns and rows (T, 2) of the tips on usable pixels (H, W)."""
        at = np.rint(self.px[view, self.tip & self.visible[view]]).astype(np.int64)
        at = at[((at >= 0) & (at < usable.shape[::-1])).all(axis=1)]
        return at[usable[at[:, 1], at[:, 0]]]

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
        half = [
            np.maximum(self.radius_mm[at] * np.linalg.norm(way, axis=1) - _PEN_PX, 0.0)  # of a sphere
            for at, way in zip((first, last), gradient, strict=True)
        ]
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
        use = at.segments(k)
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
