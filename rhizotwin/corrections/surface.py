"""The surface of a corrected shape: the original one, closed where parts were deleted, with tubes for new roots."""

from __future__ import annotations

import numpy as np
import trimesh
from numpy.typing import NDArray

from rhizotwin.corrections.solid import Solid
from rhizotwin.corrections.state import State
from rhizotwin.recon.results.parts import Mesh
from rhizotwin.root_mesh import tube

Array = NDArray[np.float64]
Faces = NDArray[np.int64]

_LOST = 0.5
"""A face is removed where the voxels around it lost more than this fraction of their volume."""


def corrected(mesh: Mesh, solid: Solid, state: State, volumes_mm3: Array) -> trimesh.Trimesh:
    """Return the surface of a corrected shape.

    Parameters
    ----------
    mesh : Mesh
        Surface before corrections.
    solid, state : Solid, State
        Voxels, and roots after corrections.
    volumes_mm3 : (N,) float64 array
        Volume in each voxel after corrections.
    """
    kept = _kept(mesh, solid, volumes_mm3)
    vertices, faces = (mesh.vertices_mm, mesh.faces) if kept.all() else _closed(mesh.vertices_mm, mesh.faces, kept)
    parts = [(vertices, faces), *_made(solid, state)]
    first = np.cumsum([0, *(len(points) for points, _ in parts[:-1])])
    whole = np.concatenate([triangles + start for (_, triangles), start in zip(parts, first, strict=True)])
    made = trimesh.Trimesh(np.concatenate([points for points, _ in parts]), whole, process=False)
    made.remove_unreferenced_vertices()
    return made


def _kept(mesh: Mesh, solid: Solid, volumes_mm3: Array) -> NDArray[np.bool_]:
    """Return which faces (F,) remain: those whose voxels kept their volume, or that are in none."""
    middle = mesh.vertices_mm[mesh.faces].mean(axis=1)
    kept = np.ones(len(middle), bool)
    lost = np.flatnonzero(volumes_mm3 < solid.measured_mm3[: len(volumes_mm3)])
    if not len(lost):
        return kept
    near = np.flatnonzero(_beside(middle, solid.centre_mm[lost], np.asarray((0.5 * solid.size[lost] + 1.0) * solid.voxel_mm)))
    middle = middle[near]  # unchanged elsewhere
    away = [np.array(step, np.float64) for step in np.ndindex(3, 3, 3)]
    before, after = np.zeros(len(middle)), np.zeros(len(middle))
    for step in away:  # a face may be in the empty voxel beside the one that it bounds
        row = solid.find(middle + (step - 1.0) * 0.5 * solid.voxel_mm)
        there = row >= 0
        before[there] += solid.measured_mm3[row[there]]
        after[there] += np.minimum(volumes_mm3[row[there]], solid.measured_mm3[row[there]])
    kept[near] = (before <= 0.0) | (after > (1.0 - _LOST) * before)
    return kept


def _beside(points: Array, centre: Array, reach_mm: Array) -> NDArray[np.bool_]:
    """Return which points (N, 3) may be in cubes (M, 3) with half edges (M,): those in grid cells that cubes touch."""
    cell_mm = 2.0 * float(reach_mm.max())  # then each cell that a cube touches contains a corner of it
    low = (centre - reach_mm[:, None]).min(axis=0)
    touched = np.zeros(np.ceil(np.ptp(centre, axis=0) / cell_mm).astype(int) + 3, bool)
    for corner in np.ndindex(2, 2, 2):
        touched[tuple(((centre + (2.0 * np.array(corner) - 1.0) * reach_mm[:, None] - low) / cell_mm).astype(int).T)] = True
    cell = np.floor((points - low) / cell_mm).astype(int)
    within = ((cell >= 0) & (cell < touched.shape)).all(axis=1)
    within[within] = touched[tuple(cell[within].T)]
    return within


def _closed(vertices: Array, faces: Faces, kept: NDArray[np.bool_]) -> tuple[Array, Faces]:
    """Remove faces and close the holes with fans about their centres."""
    rim = np.zeros(len(vertices), bool)
    rim[faces[~kept]] = True
    faces = faces[kept]
    beside = faces[rim[faces].sum(axis=1) >= 2]
    edges = np.concatenate([beside[:, [0, 1]], beside[:, [1, 2]], beside[:, [2, 0]]])
    edges = edges[rim[edges].all(axis=1)]
    key, twin = edges @ [len(vertices), 1], edges @ [1, len(vertices)]
    onward: dict[int, list[int]] = {}
    for a, b in edges[~np.isin(key, twin)].tolist():
        onward.setdefault(b, []).append(a)  # opposite to the faces, so that the fan has their orientation
    points, fans = [vertices], []
    count = len(vertices)
    while onward:
        start = next(iter(onward))
        loop, here = [start], start
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


def _made(solid: Solid, state: State) -> list[tuple[Array, Faces]]:
    """Return the tubes of the sources that corrections added."""
    numbers = sorted({piece.source for piece in state.pieces if piece.source >= solid.given})
    return [tube(*solid.sources[number]) for number in numbers]
