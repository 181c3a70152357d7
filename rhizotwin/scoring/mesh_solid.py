"""Volume and intersection over union of meshes, in which overlaps count once."""

from __future__ import annotations

from dataclasses import dataclass

import manifold3d
import numpy as np

from rhizotwin.recon.results.parts import Mesh
from rhizotwin.scoring import voxelise
from rhizotwin.sim.overlaps import SMALLEST, relative_overlap, unite_overlaps
from rhizotwin.sim.solids import invert, to_manifold

_MOST_SIDE = 200
"""Number of voxels along the longest side of the bounding box. Meshes that intersect themselves are compared with the
true solid on this grid."""


@dataclass(frozen=True)
class MeshSolid:
    """Solid that a mesh bounds."""

    solid: manifold3d.Manifold
    """Solid without overlaps, mm."""
    was_united: bool
    """Whether parts of the mesh overlap and were united."""


def compare_volumes(mesh: Mesh, true: Mesh) -> tuple[float | None, float | None, tuple[str, ...]]:
    """Compute the volume of a mesh, mm3, and its intersection over union with the true surface.

    They are exact if `to_solid` can convert both meshes. Otherwise, they are computed from voxels.

    Returns
    -------
    volume_mm3, iou : float or None
        Both are None if the mesh is not closed.
    notes : tuple of str
        Sentences for the user.
    """
    found, known = to_solid(mesh), to_solid(true)
    if found is None or known is None:
        return _compare_with_voxels(mesh, true)
    volume_mm3 = found.solid.volume()
    both_mm3 = (found.solid ^ known.solid).volume()
    iou = min(1.0, both_mm3 / (volume_mm3 + known.solid.volume() - both_mm3))
    return volume_mm3, iou, ("parts of the mesh overlap and were united",) if found.was_united else ()


def _compare_with_voxels(mesh: Mesh, true: Mesh) -> tuple[float | None, float | None, tuple[str, ...]]:
    """Compute the same as `compare_volumes` from voxels."""
    points = np.concatenate([one.vertices_mm[np.unique(one.faces)] for one in (mesh, true)])
    low = points.min(axis=0)
    extent_mm = np.ptp(points, axis=0)
    voxel_mm = float(extent_mm.max()) / _MOST_SIDE
    cells = np.argwhere(np.ones(np.maximum(np.ceil(extent_mm / voxel_mm).astype(int), 1), bool)).astype(np.int32)
    size = np.ones(len(cells), np.int32)
    try:
        inside, truth = (
            voxelise.count_in_boxes(one.vertices_mm, one.faces, cells, size, origin_mm=low, voxel_mm=voxel_mm) > 0 for one in (mesh, true)
        )
    except ValueError:
        return None, None, ("the volume is undefined, because the mesh is not closed",)
    either = int((inside | truth).sum())
    note = f"the mesh folds into itself or its normals point inwards; volume and IoU were computed with voxels of {voxel_mm:.3f} mm"
    return float(inside.sum()) * voxel_mm**3, int((inside & truth).sum()) / either if either else 0.0, (note,)


def to_solid(mesh: Mesh) -> MeshSolid | None:
    """Convert a mesh to a solid in which overlaps count once, also those of a shell with itself.

    The result is None if no exact solid can be computed: the mesh is not closed, a shell folds into itself, or normals
    point inwards (except those of a cavity).
    """
    solid = to_manifold(mesh.vertices_mm, mesh.faces.astype(np.int32))
    if solid.status() != manifold3d.Error.NoError or solid.volume() <= 0.0:
        return None
    if relative_overlap(solid) <= SMALLEST:
        return MeshSolid(solid, was_united=False)
    united = _unite_shells(solid.decompose())
    return None if united is None else MeshSolid(united, was_united=True)


def _unite_shells(shells: list[manifold3d.Manifold]) -> manifold3d.Manifold | None:
    found_bodies = [unite_overlaps(shell) for shell in shells if shell.volume() > 0.0]
    found_cavities = [unite_overlaps(invert(shell)) for shell in shells if shell.volume() < 0.0]
    bodies, cavities = ([solid for solid in solids if solid is not None] for solids in (found_bodies, found_cavities))
    if len(bodies) < len(found_bodies) or len(cavities) < len(found_cavities):
        return None
    united = manifold3d.Manifold.batch_boolean(bodies, manifold3d.OpType.Add)
    if not cavities:
        return united
    holes = manifold3d.Manifold.batch_boolean(cavities, manifold3d.OpType.Add)
    # a cavity that another body covers or fills is left to the voxels
    is_simple = abs(sum((body ^ holes).volume() for body in bodies) / holes.volume() - 1.0) <= SMALLEST
    return united - holes if is_simple else None
