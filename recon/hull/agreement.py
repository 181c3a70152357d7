"""Consistency of each view with a reconstructed shape, and detection of views that contradict all others.

The shape is a set of cubes. Two kinds of inconsistency are measured in each view: coverage that no cube explains, and
cubes that project onto empty pixels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.coverage.measure import MOST_WRONG
from rhizotwin.recon.coverage.silhouettes import Silhouette
from rhizotwin.recon.device import points
from rhizotwin.recon.hull.carve import Water
from rhizotwin.recon.hull.distance_maps import least_votes
from rhizotwin.recon.hull.leaves import Leaves, halve
from rhizotwin.recon.optics import projection
from rhizotwin.recon.optics.projection import ViewBank

Array = NDArray[np.float64]

_NEAR_PX = 1.5
"""Tolerance added to the projected extent of a cube, px, to allow for interpolation and rounding to whole pixels."""
_COVERED = 0.1
"""Coverage above which a pixel shows a root (see `silhouettes`)."""
_FINE = 128
"""Number of fine cubes along the edge of a cube with the same volume as the water, on which the views are compared. In
the canister of the thesis, they have an edge of 1 mm, or 4 px in pictures of 800 px."""
_WRONG, _WRONG_TIMES = 0.1, 4.0
"""Absolute and relative threshold above which a view is wrong. The inconsistency of a wrong view exceeds 0.1, and it
exceeds four times the median over all views.

The inconsistency is the larger of two fractions: the coverage of the view that no cube explains, and the cubes accepted
by all other views that the view excludes. The maximum in a correct scan is 0.013; a mirrored view of a printed root has
0.17 (`docs/decisions/pictures-and-trust.md`)."""


@dataclass(frozen=True)
class Agreement:
    """Agreement of V views with a shape made of N cubes."""

    shown: Array
    """Total covered area among the usable pixels of each view, shape (V,), px."""
    missed: Array
    """Covered area in each view that is not explained by any cube, shape (V,), px."""
    sees: NDArray[np.bool_]
    """Whether each cube is projected onto usable pixels in each view, shape (V, N)."""
    excluded: NDArray[np.bool_]
    """Whether each cube is projected only onto empty pixels in each view, shape (V, N)."""

    @property
    def missed_share(self) -> Array:
        """Fraction of each view's covered area that is not explained by any cube, shape (V,).

        It is 0 for a view without coverage.
        """
        return self.missed / np.maximum(self.shown, 1e-9)

    @property
    def share(self) -> float:
        """Fraction of the covered area, summed over all views, that is not explained by any cube."""
        return float(self.missed.sum() / max(float(self.shown.sum()), 1e-9))


def compare(bank: ViewBank, silhouettes: Sequence[Silhouette], middles_mm: Array, edge_mm: Array) -> Agreement:
    """Compare a shape made of cubes with the silhouettes of all views.

    Parameters
    ----------
    bank : ViewBank
        Views.
    silhouettes : (V,) sequence of Silhouette
        Silhouettes of the same views.
    middles_mm : (N, 3) array
        Centres of the cubes, canister frame.
    edge_mm : (N,) array
        Edge lengths of the cubes, mm.
    """
    shown, missed, sees, excluded = [], [], [], []
    for k, silhouette in enumerate(silhouettes):
        cubes = _ProjectedCubes.project(bank.select([k]), middles_mm, edge_mm, silhouette.coverage.shape)
        row, column, inside, reach_px = cubes.row, cubes.column, cubes.inside, cubes.reach_px
        beyond = cubes.distance()
        shown.append(float(silhouette.coverage[silhouette.usable].sum(dtype=np.float64)))
        missed.append(float(silhouette.coverage[silhouette.usable & (beyond > _NEAR_PX)].sum(dtype=np.float64)))
        nothing = (silhouette.coverage <= _COVERED) & silhouette.usable
        to_root = cv2.distanceTransform(nothing.astype(np.uint8), cv2.DIST_L2, 5)
        sees.append(inside & silhouette.usable[row, column])
        excluded.append(inside & (to_root[row, column] > reach_px + _NEAR_PX))
    return Agreement(np.array(shown), np.array(missed), np.array(sees), np.array(excluded))


def missed_pixels(bank: ViewBank, silhouette: Silhouette, middles_mm: Array, edge_mm: Array) -> NDArray[np.bool_]:
    """Return the mask (H, W) of pixels that are covered in a single view but are not explained by any cube.

    Parameters
    ----------
    bank, silhouette : ViewBank, Silhouette
        A single view and its silhouette.
    middles_mm, edge_mm : (N, 3) array, (N,) array
        Centres and edge lengths of the cubes, mm.
    """
    away = distance_px(bank, middles_mm, edge_mm, silhouette.coverage.shape)
    return np.asarray(silhouette.usable & (silhouette.coverage > 0.5) & (away > 0.5))


def distance_px(bank: ViewBank, middles_mm: Array, edge_mm: Array, shape: tuple[int, ...]) -> NDArray[np.float32]:
    """Return the distance (H, W) of each pixel of a single view from the nearest projected cube, px.

    Parameters
    ----------
    bank : ViewBank
        A single view.
    middles_mm, edge_mm : (N, 3) array, (N,) array
        Centres and edge lengths of the cubes, mm.
    shape : tuple of int
        Height and width of the picture.
    """
    return _ProjectedCubes.project(bank, middles_mm, edge_mm, shape).distance()


def pixels(bank: ViewBank, middles_mm: Array, shape: tuple[int, ...]) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Project points into a single view. Return their flattened pixel indices (N,) and whether they are visible (N,).

    Parameters
    ----------
    bank : ViewBank
        A single view.
    middles_mm : (N, 3) array
        Points, canister frame.
    shape : tuple of int
        Height and width of the picture.
    """
    placed = _ProjectedCubes.project(bank, middles_mm, np.zeros(len(middles_mm)), shape)
    return placed.row * shape[1] + placed.column, placed.inside


def find_wrong_views(bank: ViewBank, silhouettes: Sequence[Silhouette], water: Water) -> list[int]:
    """Return the indices of views that contradict all others, such as a mirrored or truncated picture.

    The views are compared with a tolerant hull, from which a cube is removed only if more views exclude it than may be
    wrong. The least consistent view is removed and the comparison is repeated, until no view is wrong.

    Parameters
    ----------
    bank : ViewBank
        Views.
    silhouettes : (V,) sequence of Silhouette
        Silhouettes of the same views.
    water : Water
        Space that may contain roots.

    Returns
    -------
    list of int
        Indices of the wrong views. Empty if no view is wrong, or if too many are.
    """
    left, wrong = list(range(bank.count)), list[int]()
    while len(left) > 2:
        found = _find_worst(bank.select(left), [silhouettes[k] for k in left], water)
        if found is None:
            return wrong
        wrong.append(left.pop(found))
        if len(wrong) > _most_wrong(bank):
            return []
    return []


def _most_wrong(bank: ViewBank) -> int:
    """Return how many views may be wrong."""
    return max(1, int(MOST_WRONG * bank.count))


def _find_worst(bank: ViewBank, silhouettes: Sequence[Silhouette], water: Water) -> int | None:
    """Return the index of the view that contradicts the others most, or None if no view is wrong."""
    fine_mm = float(np.cbrt(np.pi * water.radius_mm**2 * (water.top_mm - water.bottom_mm))) / _FINE
    cubes = Leaves.whole(water.grid(fine_mm))
    cubes = cubes.select(np.hypot(*cubes.middles_mm[:, :2].T) < water.radius_mm)
    while True:
        edge_mm = fine_mm * cubes.size.astype(np.float64)
        found = compare(bank, silhouettes, cubes.middles_mm, edge_mm)
        kept = (found.excluded.sum(axis=0) <= _most_wrong(bank)) & (found.sees.sum(axis=0) >= least_votes(bank.count))
        cubes, edge_mm, excluded = cubes.select(kept), edge_mm[kept], found.excluded[:, kept]
        if not len(cubes.size):
            return None
        if cubes.size[0] == 1:
            break
        cubes = halve(cubes)
    missed = compare(bank, silhouettes, cubes.middles_mm, edge_mm).missed_share
    wrong = np.maximum(missed, excluded.mean(axis=1))
    worst = int(wrong.argmax())
    return worst if wrong[worst] > max(_WRONG, _WRONG_TIMES * float(np.median(wrong))) else None


@dataclass(frozen=True)
class _ProjectedCubes:
    """Projection of N cubes into one view."""

    shape: tuple[int, ...]
    edge_mm: Array
    row: NDArray[np.int64]
    column: NDArray[np.int64]
    """Column of the pixel nearest to each cube's centre, shape (N,). Row and column are both 0 for a cube outside the
    picture."""
    reach_px: Array
    """Distance from each cube's projected centre to its farthest corner, shape (N,), px."""
    inside: NDArray[np.bool_]
    """Whether the centre of each cube is visible within the picture, shape (N,)."""

    @staticmethod
    def project(bank: ViewBank, middles_mm: Array, edge_mm: Array, shape: tuple[int, ...]) -> _ProjectedCubes:
        p = projection.project(bank, dr.zeros(mi.UInt32, len(middles_mm)), points(middles_mm), mi.Bool(True))
        dr.eval(p.px, p.du, p.dv, p.visible)
        px, *gradients = (np.stack([np.array(part, np.float64) for part in vector], axis=-1) for vector in (p.px, p.du, p.dv))
        scale = np.maximum(*(np.linalg.norm(by_point, axis=1) for by_point in gradients))
        inside = np.array(dr.select(p.visible, mi.UInt32(1), mi.UInt32(0))) > 0
        inside &= (px > 0.0).all(axis=1) & (px < np.array([shape[1] - 1, shape[0] - 1])).all(axis=1)
        column, row = np.round(np.where(inside[:, None], px, 0.0)).astype(np.int64).T
        return _ProjectedCubes(shape, edge_mm, row, column, scale * 0.5 * 3.0**0.5 * edge_mm, inside)

    def distance(self) -> NDArray[np.float32]:
        """Return the distance (H, W) of each pixel from the nearest projected cube, px.

        It is infinite if there are no cubes.
        """
        beyond = np.full(self.shape, np.inf, np.float32)
        for edge in np.unique(self.edge_mm):
            chosen = (self.edge_mm == edge) & self.inside
            if chosen.any():
                empty = np.ones(self.shape, np.uint8)
                empty[self.row[chosen], self.column[chosen]] = 0
                away = cv2.distanceTransform(empty, cv2.DIST_L2, 5) - np.float32(self.reach_px[chosen].max())
                beyond = np.minimum(beyond, away)
        return beyond
