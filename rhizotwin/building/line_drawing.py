"""Line drawings of solids.

Silhouettes and sharp edges are drawn, and hidden lines are removed.
"""

from dataclasses import dataclass

import numpy as np
from manifold3d import Manifold
from numpy.typing import NDArray
from scipy.ndimage import minimum_filter

from rhizotwin.building.part import surface
from rhizotwin.drawing.shading import Side, rasterise
from rhizotwin.recon.results.parts import Mesh
from rhizotwin.scenes.frames import Array

SHARP_DEG = 25.0
"""Minimum angle between the normals of adjacent faces for which their common edge is drawn. On a round wall with 240
sides the angle is 1.5 degrees, so that the edges between its faces are not drawn."""
PIXELS = 700
"""Size of the depth image for the hidden-line test: number of pixels along its longer side."""
NEAR_PX = 2.5
"""Depth tolerance of the hidden-line test, in pixels of the depth image. Visible edges lie on the surface, and would
otherwise be hidden by rounding errors of the depth."""

TOP = Side(name="from above", right=(1.0, 0.0, 0.0), up=(0.0, 1.0, 0.0), right_label="x (mm)")
FRONT = Side(name="from the front", right=(1.0, 0.0, 0.0), up=(0.0, 0.0, 1.0), right_label="x (mm)")
RIGHT = Side(name="from the right", right=(0.0, 1.0, 0.0), up=(0.0, 0.0, 1.0), right_label="y (mm)")
_SLOPE, _TURN = np.deg2rad(30.0), np.deg2rad(-50.0)
CORNER = Side(
    name="from a corner",
    right=(float(-np.sin(_TURN)), float(np.cos(_TURN)), 0.0),
    up=(float(-np.sin(_SLOPE) * np.cos(_TURN)), float(-np.sin(_SLOPE) * np.sin(_TURN)), float(np.cos(_SLOPE))),
    right_label="",
)
"""Axonometric view from above. The viewer stands between +x, where the camera is, and -y."""


@dataclass(frozen=True, kw_only=True)
class Drawn:
    """Visible lines of a solid in one view."""

    strokes_mm: list[Array]
    """Polylines (N, 2) in the right and up coordinates of the view."""
    low_mm: Array
    """Lower left corner (2,) of the solid's bounding box in the view."""
    high_mm: Array

    @property
    def size_mm(self) -> Array:
        """Width and height (2,) of the solid in the view."""
        return self.high_mm - self.low_mm


def draw(solid: Manifold, side: Side) -> Drawn:
    """Compute the visible sharp edges and silhouette edges of a solid.

    Notes
    -----
    Each edge is divided into pieces of one pixel of a depth image, and pieces behind the surface in the depth image are
    removed.
    """
    vertices, faces = surface(solid)
    view = vertices @ side.axes.T
    low, high = view.min(axis=0), view.max(axis=0)
    px_mm = float(max(high[0] - low[0], high[1] - low[1])) / PIXELS
    margin = 3.0 * px_mm
    box = (float(low[0]) - margin, float(high[0]) + margin, float(low[1]) - margin, float(high[1]) + margin)
    depth = _nearest(Mesh(vertices_mm=vertices, faces=faces), side, box, px_mm)
    ends = view[_edges(view, faces)]
    counts = np.maximum(2, np.ceil(np.hypot(*(ends[:, 1] - ends[:, 0]).T[:2]) / px_mm).astype(int) + 1)
    edge = np.repeat(np.arange(len(ends)), counts)
    share = (np.arange(len(edge)) - np.repeat(np.cumsum(counts) - counts, counts)) / np.repeat(counts - 1, counts)
    points = ends[edge, 0] + share[:, None] * (ends[edge, 1] - ends[edge, 0])
    strokes = _runs(points, edge, _seen(points, depth, box, px_mm))
    return Drawn(strokes_mm=_chained(strokes), low_mm=low[:2], high_mm=high[:2])


def _nearest(mesh: Mesh, side: Side, box: tuple[float, float, float, float], px_mm: float) -> Array:
    """Compute the depth image (H, W) of a mesh.

    The depth is the coordinate towards the viewer. It is -inf in pixels that show no surface.
    """
    raster = rasterise(mesh, side, box_mm=box, px_mm=px_mm)
    return np.where(raster.hit, raster.depth_mm, -np.inf)


def _edges(view: Array, faces: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the edges (E, 2) to draw, as pairs of vertex indices.

    They are the sharp edges and the silhouette edges of a closed surface.
    """
    a, b, c = (view[faces[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    normal /= np.maximum(length, 1e-12)
    ends = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    face = np.tile(np.arange(len(faces)), 3)
    key = np.sort(ends, axis=1)
    order = np.lexsort((key[:, 1], key[:, 0]))
    one, other = face[order[0::2]], face[order[1::2]]  # each edge of a closed surface has two faces
    sharp = np.einsum("ij,ij->i", normal[one], normal[other]) < np.cos(np.deg2rad(SHARP_DEG))
    edge_on = 1e-6
    outline = (normal[one, 2] > edge_on) != (normal[other, 2] > edge_on)
    return np.asarray(key[order[0::2]][sharp | outline])


def _seen(points: Array, depth: Array, box: tuple[float, float, float, float], px_mm: float) -> NDArray[np.bool_]:
    """Return a mask (N,) of the points (N, 3) that are visible.

    A point is hidden if it lies behind the surfaces in its pixel and in all eight adjacent pixels.
    """
    column = (points[:, 0] - box[0]) / px_mm - 0.5
    row = (box[3] - points[:, 1]) / px_mm - 0.5
    x = np.clip(np.rint(column).astype(int), 0, depth.shape[1] - 1)
    y = np.clip(np.rint(row).astype(int), 0, depth.shape[0] - 1)
    return np.asarray(points[:, 2] >= minimum_filter(depth, 3)[y, x] - NEAR_PX * px_mm)


def _runs(points: Array, edge: NDArray[np.int64], seen: NDArray[np.bool_]) -> list[Array]:
    """Return the two end points (2, 2) of each visible part of the edges.

    Each point is a sample of a straight edge, whose index is given by ``edge`` (N,).
    """
    same = np.concatenate([[False], (edge[1:] == edge[:-1]) & seen[1:] & seen[:-1], [False]])
    change = np.flatnonzero(np.diff(same.astype(np.int8)))
    return [points[[start, stop], :2] for start, stop in zip(change[0::2], change[1::2], strict=True)]


def _chained(strokes: list[Array]) -> list[Array]:
    """Join consecutive strokes to polylines.

    This reduces the size of the file, and does not change the drawing.
    """
    kept: dict[tuple[int, ...], Array] = {}
    for stroke in strokes:  # two edges may coincide in the view
        key = tuple(np.rint(stroke * 100.0).astype(int).ravel())
        kept.setdefault(min(key, key[2:] + key[:2]), stroke)
    ends: dict[tuple[int, int], list[int]] = {}
    pieces = list(kept.values())
    for number, piece in enumerate(pieces):
        for end in piece:
            ends.setdefault(_place(end), []).append(number)
    left = set(range(len(pieces)))
    lines = []
    while left:
        number = left.pop()
        line = [pieces[number][0], pieces[number][1]]
        for forward in (True, False):
            while (following := _next(ends, left, line[-1] if forward else line[0])) is not None:
                left.discard(following)
                one, two = pieces[following]
                here = _place(line[-1] if forward else line[0])
                point = two if _place(one) == here else one
                line.append(point) if forward else line.insert(0, point)
        lines.append(np.array(line))
    return lines


def _place(point: Array) -> tuple[int, int]:
    x, y = np.rint(point * 1000.0).astype(int)
    return int(x), int(y)


def _next(ends: dict[tuple[int, int], list[int]], left: set[int], at: Array) -> int | None:
    meeting = ends.get(_place(at), [])
    return next((number for number in meeting if number in left), None) if len(meeting) == 2 else None
