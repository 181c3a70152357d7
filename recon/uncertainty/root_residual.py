"""Comparison of rendered roots with a picture: lengths, tips and widths that are missing or surplus.

Coverage far from all rendered roots, thinned to lines, is missing length, and each connected line a missing root with
its tip. Centre lines and tips of roots without coverage nearby are surplus.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import drjit as dr
import numpy as np
from numpy.typing import NDArray
from skimage.measure import label
from skimage.morphology import skeletonize

from rhizotwin.recon.coverage.silhouettes import Mask, Silhouette
from rhizotwin.recon.optics import projection
from rhizotwin.recon.optics.projection import ViewBank
from rhizotwin.recon.roots.organs import THICK_PX
from rhizotwin.scenes import polyline
from rhizotwin.scenes.rsml import Root

Array = NDArray[np.float64]
Fixed = NDArray[np.int32]
"""Positions and sizes in fractions of pixels, as used by OpenCV's drawing functions."""

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
_RESOLVED_PX = 2.0
"""Maximum width of a root in the measure of crowding, px. Wider roots are resolved, and can be separated from others
that overlap them."""
_LEAST_FREE = 0.1
"""Minimum fraction of the root zone outside the roots, for the correction of missing roots for hidden ones."""


@dataclass(frozen=True)
class Residual:
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


def compare(silhouette: Silhouette, drawn: NDArray[np.float32], places: Places, view: int) -> Residual | None:
    """Compare a picture with the rendered roots, within usable pixels; None if the picture shows no rendered root.

    Parameters
    ----------
    silhouette : Silhouette
        Measured coverage (H, W).
    drawn : (H, W) float32 array
        Coverage by the rendered roots, and by solids.
    places : Places
        Projections of the nodes.
    view : int
        Index of the view.
    """
    usable = silhouette.usable
    found, made = (
        cv2.GaussianBlur(np.where(usable, picture, 0.0).astype(np.float32), (0, 0), _SMOOTH_PX) for picture in (silhouette.coverage, drawn)
    )
    covered = (found > _LINE) & usable
    centres, tips = places.centre_lines(view, usable.shape)[0] & usable, places.tips(view, usable)
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
    return Residual(
        missing=missing,
        surplus=surplus,
        missing_tips=len(sizes) / free / max(len(tips), 1),
        surplus_tips=float(beside_picture[tips[:, 1], tips[:, 0]].mean()) if len(tips) else 0.0,
        width=area / max(1.0 + missing - surplus, 1e-9) - 1.0,
    )


def _dilate(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the pixels within two of a mask (H, W)."""
    return np.asarray(cv2.dilate(mask.astype(np.uint8), _NEAR) > 0)


@dataclass(frozen=True)
class Places:
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
    def project(roots: Sequence[Root], bank: ViewBank) -> Places:
        """Project roots into all views."""
        points = np.concatenate([root.points_mm for root in roots])
        step = np.concatenate([[*polyline.steps_mm(root.points_mm), 0.0] for root in roots])
        at = projection.project_into_all(bank, points)
        dr.eval(at.px, at.du, at.dv, at.visible)  # evaluated together, to project once
        shape = (bank.count, len(points))
        px, du, dv = (np.stack([np.array(part).reshape(shape) for part in vector], axis=-1) for vector in (at.px, at.du, at.dv))
        gradient = np.stack([du, dv], axis=-2)
        radius = np.concatenate([root.diameters_mm for root in roots]) / 2.0
        tip = np.concatenate([(np.arange(len(root.points_mm)) == len(root.points_mm) - 1) & root.tip_seen for root in roots])
        return Places(radius, step, px, gradient, np.array(at.visible).reshape(shape), tip)

    @cached_property
    def px_a_mm(self) -> float:
        """Median scale of the pictures at the visible nodes, px/mm; 0 if no node is visible."""
        return float(np.median(np.linalg.norm(self.gradient, axis=-1)[self.visible])) if self.visible.any() else 0.0

    def segments(self, view: int) -> NDArray[np.bool_]:
        """Return the mask (N - 1,) of nodes that are visible together with the next node of their root."""
        return self.visible[view, :-1] & self.visible[view, 1:] & (self.step_mm[:-1] > 0.0)

    def centre_lines(self, view: int, shape: tuple[int, ...]) -> tuple[NDArray[np.bool_], float]:
        """Return the mask (H, W) of the pixels on centre lines, and the sum of the lengths of all lines in pixels."""
        canvas, first = np.zeros(shape, np.uint8), np.flatnonzero(self.segments(view))
        ends = np.rint(np.stack([self.px[view, first], self.px[view, first + 1]], axis=1)).astype(np.int32)
        cv2.polylines(canvas, list(ends), False, 1, lineType=cv2.LINE_8)
        return canvas > 0, float(np.abs(ends[:, 1] - ends[:, 0]).max(axis=1, initial=0).sum())

    def overlap(self, view: int, shape: tuple[int, ...]) -> float:
        """Return the length of all centre lines relative to that of the pixels (H, W) on them, minus 1."""
        lines, length_px = self.centre_lines(view, shape)
        return max(0.0, length_px / max(float(lines.sum()), 1.0) - 1.0)

    def crowding(self, view: int, shape: tuple[int, ...]) -> float:
        """Return the area of all roots in a picture (H, W) relative to the area that they cover together, minus 1.

        Roots are lines as wide as the root blurred by one pixel, at most `_RESOLVED_PX`.
        """
        scale = self.px_a_mm or 1.0  # it is 0 if no node is visible
        wide_px = np.minimum(np.hypot(2.0 * self.radius_mm * scale, 1.0), _RESOLVED_PX)
        drawn = replace(self, radius_mm=0.5 * wide_px / scale)
        first, sides = drawn.pieces(view, np.flatnonzero(self.segments(view)))
        canvas = np.zeros([_FINER * edge for edge in shape], np.uint8)
        for corners in sides:
            cv2.fillConvexPoly(canvas, corners, 1, lineType=cv2.LINE_8, shift=_SHIFT)
        whole = float(np.linalg.norm(self.px[view, first + 1] - self.px[view, first], axis=1) @ wide_px[first])
        covered = float(np.count_nonzero(canvas)) / _FINER**2
        return max(0.0, whole / max(covered, 1.0) - 1.0)

    def hidden_share(self, shape: tuple[int, ...]) -> tuple[Mask, Array]:
        """Return the mask (N,) of nodes of thin roots, and the fraction (N,) of pictures in which thick ones hide each.

        The pictures have the shape (H, W). Roots whose radius is at least `THICK_PX` are thick.
        """
        radius_px, hidden = self.radius_mm * self.px_a_mm, np.zeros(self.visible.shape, bool)
        thick = radius_px >= THICK_PX
        for view, px in enumerate(np.rint(self.px).astype(np.int64)):
            shown = thick & self.visible[view]
            column, row = np.clip(px.T, 0, [[shape[1] - 1], [shape[0] - 1]])
            hidden[view] = draw_discs(px[shown], radius_px[shown], shape)[row, column]
        return ~thick, hidden.mean(axis=0)

    def tips(self, view: int, usable: NDArray[np.bool_]) -> NDArray[np.int64]:
        """Return the columns and rows (T, 2) of the tips on usable pixels (H, W)."""
        at = np.rint(self.px[view, self.tip & self.visible[view]]).astype(np.int64)
        at = at[((at >= 0) & (at < usable.shape[::-1])).all(axis=1)]
        return at[usable[at[:, 1], at[:, 0]]]

    def thin_share(self, limit_px: float, *, power: int = 0) -> float:
        """Return the fraction of the length that is thinner than a limit, px; with a power of 2, of the volume."""
        amount = self.step_mm * self.radius_mm**power
        return float(amount[2.0 * self.radius_mm * self.px_a_mm < limit_px].sum()) / max(float(amount.sum()), 1e-9)

    def pieces(self, view: int, first: NDArray[np.int64]) -> tuple[NDArray[np.int64], Fixed]:
        """Return segments of tubes from nodes (M,) to the next of their root.

        Returns
        -------
        first : (K,) int64 array
            Start nodes of the segments that have a length in the picture.
        corners : (K, 4, 2) int32 array
            Corners of their sides, in OpenCV's drawing coordinates.
        """
        step = self.px[view, first + 1] - self.px[view, first]
        size = np.hypot(*step.T)
        first, step, size = (part[size >= _LEAST_PX] for part in (first, step, size))
        across, last = np.stack([-step[:, 1], step[:, 0]], axis=1) / size[:, None], first + 1
        begin, end = self.px[view, first], self.px[view, last]
        gradient = (np.einsum("mi,mij->mj", across, self.gradient[view, at]) for at in (first, last))
        to_side, to_other = (
            np.maximum(self.radius_mm[at] * np.linalg.norm(way, axis=1) - _PEN_PX, 0.0)[:, None] * across  # of a sphere
            for at, way in zip((first, last), gradient, strict=True)
        )
        return first, _to_fixed_point(np.stack([begin + to_side, end + to_other, end - to_other, begin - to_side], axis=1))


def draw_discs(px: NDArray[np.generic], radius_px: Array, shape: tuple[int, ...]) -> Mask:
    """Return the mask (H, W) of discs with given centres (N, 2) and radii (N,), px."""
    canvas = np.zeros(shape, np.uint8)
    for at, radius in zip(np.rint(px).astype(np.int64).tolist(), np.rint(radius_px).astype(np.int64).tolist(), strict=True):
        cv2.circle(canvas, at, radius, 1, thickness=-1)
    return canvas > 0


def _to_fixed_point(px: Array) -> Fixed:
    """Convert pixels, whose centres are at integers, to OpenCV's drawing coordinates."""
    return np.rint(((px + 0.5) * _FINER - 0.5) * 2**_SHIFT).astype(np.int32)
