"""Meshes of roots as tubes for display.

The tubes have no more nodes and corners than the resolution of the screen requires.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from rhizotwin.corrections.lines import Line
from rhizotwin.recon.tubes.tube_mesh import tube
from rhizotwin.viewer.glb import Triangles, concatenate

Array = NDArray[np.float64]
Bytes = NDArray[np.uint8]
Index = NDArray[np.int64]

OFF_MM, OFF_SHARE = 0.05, 0.08
"""Maximum deviation of a displayed tube from the exact tube, as a distance in mm and as a fraction of the tube's
radius. The larger limit applies. 0.05 mm is a third of a pixel if a plant of 130 mm fills a screen of 1,000 pixels."""
FEWEST, MOST = 4, 10
"""Minimum and maximum number of corners around a tube."""
_COLOUR_STEP = 24.0
"""Maximum error of the colours that are interpolated between two displayed nodes, on a scale from 0 to 255."""
_ROUNDS = 6
"""Number of rounds in which nodes are dropped from the display. Each round can drop every other node, so that at least
one of 64 nodes is kept."""


def mesh_lines(lines: Sequence[Line], colours: Sequence[Bytes], *, most: int = MOST) -> Triangles:
    """Return the mesh of the tubes of roots or parts of roots.

    Parameters
    ----------
    lines : sequence of Line
        At least one root or part of a root.
    colours : sequence of (P, 3) uint8 array
        Colours at the points of each line.
    most : int
        Maximum number of corners around a tube.

    Returns
    -------
    Triangles
        Mesh of all tubes, closed at their ends.
    """
    ends = np.cumsum([len(line.points_mm) for line in lines])
    shown = np.split(select_nodes(lines, np.concatenate(colours)), ends[:-1])
    return concatenate([_tube(line, shade, np.flatnonzero(keep), most) for line, shade, keep in zip(lines, colours, shown, strict=True)])


def _tube(line: Line, colours: Bytes, keep: Index, most: int) -> Triangles:
    points, diameters, shades = line.points_mm[keep], line.diameters_mm[keep], colours[keep]
    around = min(corners(float(diameters.max()) / 2.0), most)
    vertices, faces = tube(points, diameters, around=around)
    out = vertices[:-2].reshape(len(points), around, 3) - points[:, None]
    ends = np.stack([points[0] - points[1], points[-1] - points[-2]])
    normals = np.concatenate([out.reshape(-1, 3), ends])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    return Triangles(vertices, normals, faces, np.concatenate([np.repeat(shades, around, axis=0), shades[[0, -1]]]))


def select_nodes(lines: Sequence[Line], colours: Bytes) -> NDArray[np.bool_]:
    """Select the points of roots that are displayed.

    Positions, radii and colours are interpolated between these points.

    Parameters
    ----------
    lines : sequence of Line
        Roots or parts of roots.
    colours : (N, 3) uint8 array
        Colours of the points of all lines, concatenated.

    Returns
    -------
    (N,) bool array
        Whether a point is displayed. The ends of each line are always displayed.
    """
    counts = np.array([len(line.points_mm) for line in lines])
    radii = np.concatenate([line.diameters_mm for line in lines]) / 2.0
    values = np.column_stack([np.concatenate([line.points_mm for line in lines]), radii, colours.astype(np.float64)])
    off = _tolerance_mm(radii)
    last = np.cumsum(counts) - 1
    fixed = np.zeros(len(values), bool)
    fixed[last], fixed[last - counts + 1] = True, True
    keep, every = np.ones(len(values), bool), np.arange(len(values))
    for round_ in range(2 * _ROUNDS):
        rank = np.cumsum(keep) - 1
        tried = keep & (fixed | (rank % 2 == round_ % 2))  # candidates without every other node
        some = np.flatnonzero(tried)
        span = np.minimum(np.cumsum(tried) - 1, len(some) - 2)
        begin, end = some[span], some[span + 1]
        share = ((every - begin) / (end - begin))[:, None]
        away = np.abs(values - (1.0 - share) * values[begin] - share * values[end])
        far = (np.linalg.norm(away[:, :3], axis=1) > off) | (away[:, 3] > off) | (away[:, 4:] > _COLOUR_STEP).any(axis=1)
        wrong = np.zeros(len(some), bool)
        wrong[span[far]] = True
        now = keep & (tried | wrong[span])
        if now.sum() == keep.sum() and round_ % 2:
            break
        keep = now
    return keep


def _tolerance_mm(radius_mm: Array) -> Array:
    return np.maximum(OFF_MM, OFF_SHARE * radius_mm)


def corners(radius_mm: float) -> int:
    """Return the smallest number of corners around a tube for which its deviation from a circle is tolerable."""
    inside = 1.0 - float(_tolerance_mm(np.array(radius_mm))) / max(radius_mm, OFF_MM)
    return int(np.clip(np.ceil(np.pi / np.arccos(inside)), FEWEST, MOST))
