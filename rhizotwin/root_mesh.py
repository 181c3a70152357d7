"""Mesh of roots for display, with one coloured tube for each root.

Tubes that overlap are not united to one surface.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rhizotwin.scenes.rsml import Root

if TYPE_CHECKING:
    import trimesh

Array = NDArray[np.float64]

AROUND = 12
"""Number of corners of the polygonal cross-section of a tube. The polygon has the same area as the circular
cross-section of the root."""
THICKEST_PERCENT = 98.0
"""Percentile of the diameters at which the colour scale ends. A thick taproot would otherwise leave only a small part
of the scale for all other roots."""


def tubes(roots: Sequence[Root], *, colour: str) -> trimesh.Trimesh:
    """Return a mesh of closed tubes along roots, in mm in the canister frame.

    Each vertex has a colour.

    Parameters
    ----------
    roots : sequence of Root
        One or more roots.
    colour : str
        Coloured property: "order" (cycle of ten colours) or "diameter" (viridis from 0 to the 98th percentile).
    """
    import trimesh  # these two imports take half a second, and the viewer uses only `tube`
    from matplotlib import colormaps

    parts = [tube(root.points_mm, root.diameters_mm) for root in roots]
    counts = [len(vertices) for vertices, _ in parts]
    first = np.concatenate([[0], np.cumsum(counts)[:-1]])
    faces = np.concatenate([part[1] + start for part, start in zip(parts, first, strict=True)])
    if colour == "order":
        shades = colormaps["tab10"](np.repeat([root.order % 10 for root in roots], counts))
    else:
        thickest = np.percentile(np.concatenate([root.diameters_mm for root in roots]), THICKEST_PERCENT)
        along = [np.concatenate([np.repeat(root.diameters_mm, AROUND), root.diameters_mm[[0, -1]]]) for root in roots]
        shades = colormaps["viridis"](np.clip(np.concatenate(along) / thickest, 0.0, 1.0))
    vertices = np.concatenate([part[0] for part in parts])
    return trimesh.Trimesh(vertices, faces, vertex_colors=np.round(255.0 * shades).astype(np.uint8), process=False)


def tube(points: Array, diameters_mm: Array, *, around: int = AROUND) -> tuple[Array, NDArray[np.int64]]:
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
