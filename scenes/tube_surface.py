"""The outside of many tubes: how much of each lies inside no other."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from scenes.rsml import Root

Array = NDArray[np.float64]

_STEP_MM = 0.3
_AROUND = 12
_NEIGHBOURS = 24
"""Stations that may hide a point: those of its own tube are among them, and a thick tube's are far from its skin."""


@dataclass(frozen=True)
class Stations:
    """Short pieces of tubes."""

    centre_mm: Array
    """(N, 3)"""
    along: Array
    """(N, 3) unit vectors."""
    length_mm: Array
    radius_mm: Array
    root: NDArray[np.int64]
    """Index of the root that each belongs to."""


def stations(roots: Sequence[Root]) -> Stations:
    """Cut roots into pieces of 0.3 mm or a little less."""
    centre, along, length, radius, owner = [], [], [], [], []
    for index, root in enumerate(roots):
        way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(root.points_mm, axis=0), axis=1))])
        if way[-1] <= 0.0:
            continue
        edges = np.linspace(0.0, way[-1], max(1, int(np.ceil(way[-1] / _STEP_MM))) + 1)
        middle = (edges[1:] + edges[:-1]) / 2.0
        at = np.stack([np.interp(edges, way, root.points_mm[:, axis]) for axis in range(3)], axis=1)
        step = np.diff(at, axis=0)
        size = np.linalg.norm(step, axis=1)
        centre.append(np.stack([np.interp(middle, way, root.points_mm[:, axis]) for axis in range(3)], axis=1))
        along.append(step / np.maximum(size, 1e-12)[:, None])
        length.append(np.diff(edges))
        radius.append(np.interp(middle, way, root.diameters_mm / 2.0))
        owner.append(np.full(len(middle), index, np.int64))
    return Stations(np.concatenate(centre), np.concatenate(along), np.concatenate(length), np.concatenate(radius), np.concatenate(owner))


def outside_mm2(tubes: Stations) -> Array:
    """Return the area (N,) of each piece's skin that lies in no other root, from twelve points round each; ends are left open."""
    helper = np.where(np.abs(tubes.along[:, 2:]) < 0.9, np.array([[0.0, 0.0, 1.0]]), np.array([[1.0, 0.0, 0.0]]))
    first = np.cross(tubes.along, helper)
    first /= np.linalg.norm(first, axis=1)[:, None]
    second = np.cross(tubes.along, first)
    angle = (np.arange(_AROUND) + 0.5) * 2.0 * np.pi / _AROUND
    ring = np.cos(angle)[None, :, None] * first[:, None] + np.sin(angle)[None, :, None] * second[:, None]
    skin = tubes.centre_mm[:, None] + tubes.radius_mm[:, None, None] * ring
    count = min(_NEIGHBOURS, len(tubes.centre_mm))
    near = cKDTree(tubes.centre_mm).query(skin.reshape(-1, 3), k=count)[1].reshape(len(skin), _AROUND, count)
    away = skin[:, :, None] - tubes.centre_mm[near]
    along = np.einsum("naki,naki->nak", away, tubes.along[near])
    beside2 = np.einsum("naki,naki->nak", away, away) - along * along
    within = (np.abs(along) <= tubes.length_mm[near] / 2.0) & (beside2 < tubes.radius_mm[near] ** 2)
    hidden = (within & (tubes.root[near] != tubes.root[:, None, None])).any(axis=2)
    area: Array = 2.0 * np.pi * tubes.radius_mm * tubes.length_mm * (1.0 - hidden.mean(axis=1))
    return area
