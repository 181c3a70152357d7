"""Surface mesh of a corrected shape. Holes that deletions leave are closed, and tubes are added for new roots."""

from __future__ import annotations

import numpy as np
import trimesh
from numpy.typing import NDArray

from rhizotwin.corrections.solid import Solid
from rhizotwin.corrections.state import State
from rhizotwin.recon.results.parts import Mesh
from rhizotwin.recon.tubes.tube_mesh import tube

Array = NDArray[np.float64]
Faces = NDArray[np.int64]

_LOST = 0.5
"""Maximum fraction of the volume in the voxels around a face that may be deleted without deleting the face."""


def corrected(mesh: Mesh, solid: Solid, state: State, volumes_mm3: Array) -> trimesh.Trimesh:
    """Return the surface mesh of a corrected shape.

    Parameters
    ----------
    mesh : Mesh
        Surface mesh before corrections.
    solid, state : Solid, State
        Voxels of the shape, and roots after corrections.
    volumes_mm3 : (N,) float64 array
        Volume in each voxel after corrections, mm3.
    """
    kept = _faces_to_keep(mesh, solid, volumes_mm3)
    vertices, faces = (mesh.vertices_mm, mesh.faces) if kept.all() else _close_holes(mesh.vertices_mm, mesh.faces, kept)
    parts = [(vertices, faces), *_added_tubes(solid, state)]
    first = np.cumsum([0, *(len(points) for points, _ in parts[:-1])])
    whole = np.concatenate([triangles + start for (_, triangles), start in zip(parts, first, strict=True)])
    made = trimesh.Trimesh(np.concatenate([points for points, _ in parts]), whole, process=False)
    made.remove_unreferenced_vertices()
    return made


def _faces_to_keep(mesh: Mesh, solid: Solid, volumes_mm3: Array) -> NDArray[np.bool_]:
    """Return a mask (F,) of the faces to keep.

    A face is removed if more than `_LOST` of the volume in the voxels around it was deleted.
    """
    middle = mesh.vertices_mm[mesh.faces].mean(axis=1)
    kept = np.ones(len(middle), bool)
    lost = np.flatnonzero(volumes_mm3 < solid.measured_mm3[: len(volumes_mm3)])
    if not len(lost):
        return kept
    near = np.flatnonzero(_may_be_inside(middle, solid.centre_mm[lost], np.asarray((0.5 * solid.size[lost] + 1.0) * solid.voxel_mm)))
    middle = middle[near]  # all other faces remain
    away = [np.array(step, np.float64) for step in np.ndindex(3, 3, 3)]
    before, after = np.zeros(len(middle)), np.zeros(len(middle))
    for step in away:  # a face may lie in the empty voxel next to the voxel that it bounds
        row = solid.find(middle + (step - 1.0) * 0.5 * solid.voxel_mm)
        there = row >= 0
        before[there] += solid.measured_mm3[row[there]]
        after[there] += np.minimum(volumes_mm3[row[there]], solid.measured_mm3[row[there]])
    kept[near] = (before <= 0.0) | (after > (1.0 - _LOST) * before)
    return kept


def _may_be_inside(points: Array, centre: Array, reach_mm: Array) -> NDArray[np.bool_]:
    """Return a mask (N,) of the points (N, 3) that may lie in one of the cubes with the given centres (M, 3).

    ``reach_mm`` is half the edge length of each cube (M,). Points near a cube may be selected as well, because the test
    uses a coarse grid.
    """
    cell_mm = 2.0 * float(reach_mm.max())  # then each cell that a cube overlaps contains a corner of the cube
    low = (centre - reach_mm[:, None]).min(axis=0)
    touched = np.zeros(np.ceil(np.ptp(centre, axis=0) / cell_mm).astype(int) + 3, bool)
    for corner in np.ndindex(2, 2, 2):
        touched[tuple(((centre + (2.0 * np.array(corner) - 1.0) * reach_mm[:, None] - low) / cell_mm).astype(int).T)] = True
    cell = np.floor((points - low) / cell_mm).astype(int)
    within = ((cell >= 0) & (cell < touched.shape)).all(axis=1)
    within[within] = touched[tuple(cell[within].T)]
    return within


def _close_holes(vertices: Array, faces: Faces, kept: NDArray[np.bool_]) -> tuple[Array, Faces]:
    """Remove all faces except ``kept``, and close the holes.

    Each hole is filled with triangles between its boundary and its centroid.
    """
    rim = np.zeros(len(vertices), bool)
    rim[faces[~kept]] = True
    faces = faces[kept]
    beside = faces[rim[faces].sum(axis=1) >= 2]
    edges = np.concatenate([beside[:, [0, 1]], beside[:, [1, 2]], beside[:, [2, 0]]])
    edges = edges[rim[edges].all(axis=1)]
    key = edges @ [len(vertices), 1]
    twin = edges @ [1, len(vertices)]
    onward: dict[int, list[int]] = {}
    for a, b in edges[~np.isin(key, twin)].tolist():
        onward.setdefault(b, []).append(a)  # opposite to the faces, so that the fan has their orientation
    points = [vertices]
    fans = []
    count = len(vertices)
    while onward:
        start = next(iter(onward))
        loop = [start]
        here = start
        while True:
            choices = onward.get(here)
            if not choices:
                break
            following = choices.pop()
            if not choices:
                del onward[here]
            if following == start:
                break
            loop.append(following)
            here = following
        if len(loop) < 3:
            continue
        ring = np.array(loop, np.int64)
        points.append(vertices[ring].mean(axis=0, keepdims=True))
        fans.append(np.stack([np.full(len(ring), count), ring, np.roll(ring, -1)], axis=1))
        count += 1
    return np.concatenate(points), np.concatenate([faces, *fans])


def _added_tubes(solid: Solid, state: State) -> list[tuple[Array, Faces]]:
    """Return the vertices and faces of each tube that corrections added."""
    numbers = sorted({piece.source for piece in state.pieces if piece.source >= solid.given})
    return [tube(*solid.sources[number]) for number in numbers]
