"""Roots as a mesh of tubes, coloured by order or diameter: for people to look at. Overlaps are not united."""

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
"""Corners of a tube's cross-section, whose area is the circle's."""
THICKEST_PERCENT = 98.0
"""Colours by diameter end here: the few points of a thick taproot do not take the scale from the laterals."""


def tubes(roots: Sequence[Root], *, colour: str) -> trimesh.Trimesh:
    """Return closed tubes along roots, canister frame, mm, with a colour a vertex.

    Parameters
    ----------
    roots : sequence of Root
        One or more.
    colour : str
        "order" (ten colours in turn) or "diameter" (viridis from 0 to the diameter that 98 % of the points stay below).
    """
    import trimesh  # these two take half a second, and the viewer needs tubes alone
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
    """Return a closed tube along a line.

    Parameters
    ----------
    points : (N, 3) float64 array
        From base to tip.
    diameters_mm : (N,)
    around : int
        Corners of its cross-section.

    Returns
    -------
    vertices : (N * around + 2, 3) float64 array
        Rings from base to tip, then the middles of both ends.
    faces : (F, 3) int64 array
        Triangles, counter-clockwise from outside.
    """
    along = np.gradient(points, axis=0)
    along /= np.maximum(np.linalg.norm(along, axis=1), 1e-12)[:, None]
    side = np.empty_like(points)
    side[0] = np.cross(along[0], np.eye(3)[int(np.argmin(np.abs(along[0])))])
    for k in range(1, len(points)):  # carried along, so that tubes do not twist
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
