"""Roots as tubes for the screen: no more nodes along them and no more corners around them than can be seen."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from rhizotwin.corrections.lines import Line
from rhizotwin.root_mesh import tube
from rhizotwin.viewer.glb import Triangles, joined

Array = NDArray[np.float64]
Bytes = NDArray[np.uint8]
Index = NDArray[np.int64]

OFF_MM, OFF_SHARE = 0.05, 0.08
"""A tube that is drawn is nowhere farther from the round one than this, or than this share of its radius where that is
more: with a plant of 130 mm on a screen of 1,000 pixels a third of a pixel; of thick ones the outline shows it."""
FEWEST, MOST = 4, 10
"""Corners around a tube; its normals are round whatever they are."""
_COLOUR_STEP = 24.0
"""A colour between two nodes that are drawn is no farther off (of 255), which cannot be seen beside another tube."""
_ROUNDS = 6
"""How often every other node may go: of 64 one is left."""


def of_lines(lines: Sequence[Line], colours: Sequence[Bytes], *, most: int = MOST) -> Triangles:
    """Return the tubes of roots or of parts of them.

    Parameters
    ----------
    lines : sequence of Line
        Centre lines and diameters; one or more.
    colours : sequence of (P, 3) uint8 array
        At each point of each of them.
    most : int
        Corners around a tube at most.

    Returns
    -------
    Triangles
        Closed at all ends.
    """
    ends = np.cumsum([len(line.points_mm) for line in lines])
    shown = np.split(kept(lines, np.concatenate(colours)), ends[:-1])
    return joined([_tube(line, shade, np.flatnonzero(keep), most) for line, shade, keep in zip(lines, colours, shown, strict=True)])


def _tube(line: Line, colours: Bytes, keep: Index, most: int) -> Triangles:
    points, diameters, shades = line.points_mm[keep], line.diameters_mm[keep], colours[keep]
    around = min(corners(float(diameters.max()) / 2.0), most)
    vertices, faces = tube(points, diameters, around=around)
    out = vertices[:-2].reshape(len(points), around, 3) - points[:, None]
    ends = np.stack([points[0] - points[1], points[-1] - points[-2]])
    normals = np.concatenate([out.reshape(-1, 3), ends])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    return Triangles(vertices, normals, faces, np.concatenate([np.repeat(shades, around, axis=0), shades[[0, -1]]]))


def kept(lines: Sequence[Line], colours: Bytes) -> NDArray[np.bool_]:
    """Return which points of roots are drawn.

    The others are, by place, radius and colour, near to what lies straight between those.

    Parameters
    ----------
    lines : sequence of Line
    colours : (N, 3) uint8 array
        At the points of all lines in a row.

    Returns
    -------
    (N,) bool array
        Both ends of each line are among them.
    """
    counts = np.array([len(line.points_mm) for line in lines])
    radii = np.concatenate([line.diameters_mm for line in lines]) / 2.0
    told = np.column_stack([np.concatenate([line.points_mm for line in lines]), radii, colours.astype(np.float64)])
    off = _off_mm(radii)
    last = np.cumsum(counts) - 1
    fixed = np.zeros(len(told), bool)
    fixed[last], fixed[last - counts + 1] = True, True
    keep, every = np.ones(len(told), bool), np.arange(len(told))
    for round_ in range(2 * _ROUNDS):
        rank = np.cumsum(keep) - 1
        tried = keep & (fixed | (rank % 2 == round_ % 2))  # without every other one
        some = np.flatnonzero(tried)
        span = np.minimum(np.cumsum(tried) - 1, len(some) - 2)
        begin, end = some[span], some[span + 1]
        share = ((every - begin) / (end - begin))[:, None]
        away = np.abs(told - (1.0 - share) * told[begin] - share * told[end])
        far = (np.linalg.norm(away[:, :3], axis=1) > off) | (away[:, 3] > off) | (away[:, 4:] > _COLOUR_STEP).any(axis=1)
        wrong = np.zeros(len(some), bool)
        wrong[span[far]] = True
        now = keep & (tried | wrong[span])
        if now.sum() == keep.sum() and round_ % 2:
            break
        keep = now
    return keep


def _off_mm(radius_mm: Array) -> Array:
    return np.maximum(OFF_MM, OFF_SHARE * radius_mm)


def corners(radius_mm: float) -> int:
    """Return how many corners a tube needs: the middles of its flats lie as near to the circle as is asked for."""
    inside = 1.0 - float(_off_mm(np.array(radius_mm))) / max(radius_mm, OFF_MM)
    return int(np.clip(np.ceil(np.pi / np.arccos(inside)), FEWEST, MOST))
