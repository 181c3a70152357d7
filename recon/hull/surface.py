"""Conversion of octree leaves of several sizes to uniform voxels and to a triangle mesh."""

from collections.abc import Iterable, Iterator

import numpy as np
import trimesh
from manifold3d import Manifold, Mesh64, OpType
from numpy.typing import NDArray
from skimage import measure

from rhizotwin.recon.hull.boxes import Box
from rhizotwin.recon.hull.leaves import Leaves

_BRICK = 96
"""Edge length of the blocks in which the surface is extracted, in voxels. A block requires 3.5 MB, and 3 % of its
voxels are shared with adjacent blocks."""
_HALF, _OFF_HALF = 0.5, 0.001
"""Occupancy at the surface, and minimum difference from it. A vertex at the centre of a voxel would be shared by
triangles that enclose nothing, and the surface would not be closed there."""


def paint(volume: NDArray[np.float32], index: NDArray[np.int32], size: NDArray[np.int32], occupancy: NDArray[np.float32]) -> None:
    """Write the occupancies of leaves into a dense block, clipped to its bounds.

    All leaves of one size are written at once.

    Parameters
    ----------
    volume : (X, Y, Z) float32 array
        Block, modified in place.
    index, size : (N, 3), (N,) int32 array
        Lowest cell and edge length of each leaf, in cells of the block.
    occupancy : (N,) float32 array
        Occupied fraction of each leaf.
    """
    for edge in np.unique(size):
        chosen = size == edge
        offset = np.stack(np.meshgrid(*[np.arange(edge)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
        at = (index[chosen][:, None, :] + offset[None]).reshape(-1, 3)
        value = np.repeat(occupancy[chosen], len(offset))
        inside = ((at >= 0) & (at < volume.shape)).all(axis=1)
        volume[tuple(at[inside].T)] = value[inside]


def _bricks(
    index: NDArray[np.int32], size: NDArray[np.int32], occupancy: NDArray[np.float32]
) -> Iterator[tuple[NDArray[np.int64], NDArray[np.float32]]]:
    """Yield the lowest corner (3,) and the dense occupancies of each block that contains leaves.

    Adjacent blocks overlap by one layer, and an empty layer surrounds all leaves.
    """
    if not len(index):
        return
    low = index.min(axis=0) - 1
    # A leaf, smaller than a brick, overlaps one or two bricks per axis.
    first, last = -((low - index) // _BRICK) - 1, (index + size[:, None] - 1 - low) // _BRICK
    box = Box(np.full(3, -1, np.int64), last.max(axis=0).astype(np.int64) + 2)
    touched = []
    for corner in np.ndindex(2, 2, 2):
        brick = np.where(corner, last, first)
        repeated = ((first == last) & np.array(corner, bool)).any(axis=1)
        touched.append(np.stack([box.number(brick)[~repeated], np.flatnonzero(~repeated)]))
    number, leaf = np.concatenate(touched, axis=1)
    order = np.argsort(number, kind="stable")
    numbers, starts = np.unique(number[order], return_index=True)
    for place, members in zip(box.cell(numbers), np.split(leaf[order], starts[1:]), strict=True):
        corner = low + place * _BRICK
        block = np.zeros((_BRICK + 1,) * 3, np.float32)
        paint(block, index[members] - corner.astype(np.int32), size[members], occupancy[members])
        yield corner.astype(np.int64), block


def surface(leaves: Leaves) -> trimesh.Trimesh:
    """Return the surface of a shape as a closed mesh, canister frame, mm.

    The surface is extracted at an occupancy of one half, block by block, with marching cubes. It lacks parts that are
    thinner than a finest node, and has no vertices if no leaf is at least half full.
    """
    vertices, faces, count = [np.zeros((0, 3))], [np.zeros((0, 3), np.int64)], 0
    for corner, block in _bricks(leaves.index, leaves.size, leaves.occupancy):
        block[np.abs(block - _HALF) < _OFF_HALF] = _HALF + _OFF_HALF
        if block.max() <= _HALF or block.min() >= _HALF:
            continue
        v, f, _, _ = measure.marching_cubes(block, level=_HALF, allow_degenerate=False)
        vertices.append(v.astype(np.float64) + corner)
        faces.append(f[:, ::-1].astype(np.int64) + count)  # counter-clockwise from outside
        count += len(v)
    mesh = trimesh.Trimesh(np.concatenate(vertices), np.concatenate(faces), process=False)
    mesh.merge_vertices(digits_vertex=5)
    mesh.vertices = leaves.grid.origin_mm + (np.asarray(mesh.vertices) + 0.5) * leaves.grid.size_mm
    return mesh


def unite(meshes: Iterable[tuple[NDArray[np.float64], NDArray[np.int64]]]) -> trimesh.Trimesh:
    """Return the union of closed meshes, each given by its vertices (V, 3), mm, and faces (F, 3)."""
    parts = [Manifold(Mesh64(vertices, faces.astype(np.uint64))) for vertices, faces in meshes if len(faces)]
    united = Manifold.batch_boolean(parts, OpType.Add).to_mesh64()
    return trimesh.Trimesh(np.asarray(united.vert_properties)[:, :3], np.asarray(united.tri_verts, np.int64), process=False)
