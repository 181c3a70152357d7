"""Exposed surface of overlapping tubes: the area of each tube that lies outside all other tubes."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from rhizotwin.scenes import polyline
from rhizotwin.scenes.rsml import Root

Array = NDArray[np.float64]

_STEP_MM = 0.3
"""Maximum length of the pieces into which a tube is divided, mm. It is about the diameter of thin roots."""
_AROUND = 8
"""Number of points on the circumference of a piece. At each of them, it is tested whether the point is inside another
root."""
_NEIGHBOURS = 24
"""Number of nearest pieces that are tested for each point, including pieces of the same tube. Near organs thicker than
7 mm, some overlaps are missed."""
_AT_ONCE = 10_000
"""Number of pieces that are processed at once. It limits the memory used to 200 MB."""


@dataclass(frozen=True)
class Stations:
    """Tubes divided into N short pieces."""

    centre_mm: Array
    """Centres of the pieces, mm, shape (N, 3)."""
    along: Array
    """Unit vectors along the pieces, shape (N, 3)."""
    length_mm: Array
    radius_mm: Array
    root: NDArray[np.int64]
    """Index of the root of each piece, shape (N,)."""


def stations(roots: Sequence[Root]) -> Stations:
    """Divide roots into pieces of at most 0.3 mm."""
    centre, along, length, radius, owner = [], [], [], [], []
    for index, root in enumerate(roots):
        way = polyline.arc_length_mm(root.points_mm)
        if way[-1] <= 0.0:
            continue
        edges = np.linspace(0.0, way[-1], max(1, int(np.ceil(way[-1] / _STEP_MM))) + 1)
        middle = (edges[1:] + edges[:-1]) / 2.0
        at = polyline.interpolate(root.points_mm, way, edges)
        step = np.diff(at, axis=0)
        size = np.linalg.norm(step, axis=1)
        centre.append(polyline.interpolate(root.points_mm, way, middle))
        along.append(step / np.maximum(size, 1e-12)[:, None])
        length.append(np.diff(edges))
        radius.append(np.interp(middle, way, root.diameters_mm / 2.0))
        owner.append(np.full(len(middle), index, np.int64))
    return Stations(np.concatenate(centre), np.concatenate(along), np.concatenate(length), np.concatenate(radius), np.concatenate(owner))


def exposed_area_mm2(tubes: Stations) -> Array:
    """Return the exposed area of each piece (N,), mm2.

    It is estimated from eight points on the circumference of each piece. The ends of tubes are not included.
    """
    tree = cKDTree(tubes.centre_mm)
    count = len(tubes.centre_mm)
    hidden = [_hidden_fraction(tubes, tree, slice(first, first + _AT_ONCE)) for first in range(0, count, _AT_ONCE)]
    area: Array = 2.0 * np.pi * tubes.radius_mm * tubes.length_mm * (1.0 - np.concatenate(hidden))
    return area


def _hidden_fraction(tubes: Stations, tree: cKDTree, part: slice) -> Array:
    """Return the fraction of each piece's surface that lies inside other tubes."""
    direction = tubes.along[part]
    helper = np.where(np.abs(direction[:, 2:]) < 0.9, np.array([[0.0, 0.0, 1.0]]), np.array([[1.0, 0.0, 0.0]]))
    first = np.cross(direction, helper)
    first /= np.linalg.norm(first, axis=1)[:, None]
    second = np.cross(direction, first)
    angle = (np.arange(_AROUND) + 0.5) * 2.0 * np.pi / _AROUND
    ring = np.cos(angle)[None, :, None] * first[:, None] + np.sin(angle)[None, :, None] * second[:, None]
    skin = tubes.centre_mm[part][:, None] + tubes.radius_mm[part][:, None, None] * ring
    count = min(_NEIGHBOURS, len(tubes.centre_mm))
    near = tree.query(skin.reshape(-1, 3), k=count, workers=-1)[1].reshape(len(skin), _AROUND, count)
    away = skin[:, :, None] - tubes.centre_mm[near]
    along = np.einsum("naki,naki->nak", away, tubes.along[near])
    beside2 = np.einsum("naki,naki->nak", away, away) - along * along
    within = (np.abs(along) <= tubes.length_mm[near] / 2.0) & (beside2 < tubes.radius_mm[near] ** 2)
    share: Array = (within & (tubes.root[near] != tubes.root[part][:, None, None])).any(axis=2).mean(axis=1)
    return share
