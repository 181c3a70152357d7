"""Triangle meshes of tubes."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rhizotwin.scenes import polyline

if TYPE_CHECKING:
    from rhizotwin.recon.tubes.tubes import Tubes  # imports SciPy, which the viewer loads on first use only

Array = NDArray[np.float64]
Faces = NDArray[np.int64]

AROUND = 12
"""Number of corners of the polygonal cross-section of a tube. The polygon has the same area as the circular
cross-section of the root."""
_CAP = np.array([0.5, 0.85, 0.98])
"""Positions of the cross-sections of a round tip beyond the last node, in radii. They enclose 94 % of the half ball."""


def mesh_parts(tubes: Tubes, use: NDArray[np.bool_]) -> Iterator[tuple[Array, Faces]]:
    """Yield the vertices and faces of a closed tube along each part of a branch with nodes of a mask (N,).

    Each part extends to the next node beyond, so that it overlaps whatever continues there. Tips are round.
    """
    for number, nodes in enumerate(tubes.branches):
        own = use[nodes]
        if number:
            own[0] = False  # a node of the parent
        wanted = own.copy()
        wanted[:-1] |= own[1:]
        wanted[1:] |= own[:-1]
        edges = np.flatnonzero(np.diff(wanted, prepend=False, append=False))
        for first, end in edges.reshape(-1, 2):
            if end - first > 1:
                points, radii = tubes.centre_mm[nodes[first:end]], tubes.radii(number)[first:end]
                if end == len(nodes):
                    onward = radii[-1] * polyline.unit_vectors(points[-1] - points[-2])
                    points = np.concatenate([points, points[-1] + _CAP[:, None] * onward])
                    radii = np.concatenate([radii, radii[-1] * np.sqrt(1.0 - _CAP**2)])
                yield tube(points, 2.0 * radii)


def tube(points: Array, diameters_mm: Array, *, around: int = AROUND) -> tuple[Array, Faces]:
    """Return a closed tube along a centre line.

    Parameters
    ----------
    points : (N, 3) float64 array
        Points of the centre line from base to tip, mm.
    diameters_mm : (N,) float64 array
        Diameter at each point.
    around : int
        Number of corners of the cross-section.

    Returns
    -------
    vertices : (N * around + 2, 3) float64 array
        Corners of the cross-sections from base to tip, then the centres of both end caps, mm.
    faces : (F, 3) int64 array
        Triangles, counter-clockwise as seen from outside.
    """
    along = _directions(points)
    side = np.empty_like(points)
    side[0] = np.cross(along[0], np.eye(3)[int(np.argmin(np.abs(along[0])))])
    for k in range(1, len(points)):  # parallel transport, so that the tube is not twisted
        side[k] = side[k - 1] - (side[k - 1] @ along[k]) * along[k]
        side[k] /= max(float(np.linalg.norm(side[k])), 1e-12)
    side[0] /= np.linalg.norm(side[0])
    up = np.cross(along, side)
    angle = np.arange(around) * 2.0 * np.pi / around
    radius = diameters_mm / 2.0 * np.sqrt(2.0 * np.pi / around / np.sin(2.0 * np.pi / around))
    ring = np.cos(angle)[:, None] * side[:, None] + np.sin(angle)[:, None] * up[:, None]
    vertices = (points[:, None] + radius[:, None, None] * ring).reshape(-1, 3)
    a = np.arange(len(points) - 1)[:, None] * around + np.arange(around)
    b = np.arange(len(points) - 1)[:, None] * around + (np.arange(around) + 1) % around
    walls = np.concatenate([np.stack([a, b, b + around], -1), np.stack([a, b + around, a + around], -1)]).reshape(-1, 3)
    last, base, tip = (len(points) - 1) * around, len(vertices), len(vertices) + 1
    turn, onward = np.arange(around), (np.arange(around) + 1) % around
    bottom = np.stack([np.full(around, base), onward, turn], axis=1)
    top = np.stack([np.full(around, tip), last + turn, last + onward], axis=1)
    return np.concatenate([vertices, points[[0, -1]]]), np.concatenate([walls, bottom, top]).astype(np.int64)


def _directions(points: Array) -> Array:
    """Return the unit tangents (N, 3) of a centre line.

    Where points coincide, the tangent is that of the next point with a direction.
    """
    along = np.gradient(points, axis=0)
    length = np.linalg.norm(along, axis=1)
    known = np.flatnonzero(length > 1e-12)
    if not len(known):
        return np.tile([0.0, 0.0, -1.0], (len(points), 1))
    used = known[np.minimum(np.searchsorted(known, np.arange(len(points))), len(known) - 1)]
    return np.asarray(along[used] / length[used, None])
