"""Conversion of closed meshes to solids in which overlaps count once."""

from __future__ import annotations

from dataclasses import dataclass

import manifold3d
import numpy as np

from rhizotwin.recon.results.parts import Mesh
from rhizotwin.sim.solids import to_manifold, to_surface

_SMALLEST = 1e-5
"""Relative volume of an overlap that is ignored. Rounding errors of thin parts are below 3e-6."""


@dataclass(frozen=True)
class MeshSolid:
    """Solid that a mesh bounds."""

    solid: manifold3d.Manifold
    """Solid without overlaps, mm."""
    was_united: bool
    """Whether shells of the mesh overlap and were united."""


def to_solid(mesh: Mesh) -> MeshSolid | None:
    """Convert a mesh to a solid whose overlapping shells are united.

    The result is None if no exact solid can be computed: the mesh is not closed, a shell intersects itself, or normals
    point inwards (except those of a cavity).
    """
    solid = to_manifold(mesh.vertices_mm, mesh.faces.astype(np.int32))
    if solid.status() != manifold3d.Error.NoError or solid.volume() <= 0.0:
        return None
    if not _overlaps(solid):
        return MeshSolid(solid, was_united=False)
    united = _unite_shells(solid.decompose())
    return None if united is None else MeshSolid(united, was_united=True)


def _unite_shells(shells: list[manifold3d.Manifold]) -> manifold3d.Manifold | None:
    if any(_overlaps(shell) for shell in shells):
        return None
    bodies, cavities = ([shell for shell in shells if sign * shell.volume() > 0.0] for sign in (1.0, -1.0))
    united = manifold3d.Manifold.batch_boolean(bodies, manifold3d.OpType.Add)
    if not cavities:
        return united
    holes = manifold3d.Manifold.batch_boolean([_invert(shell) for shell in cavities], manifold3d.OpType.Add)
    # a cavity that another body covers or fills is left to the voxels
    is_simple = abs(sum((body ^ holes).volume() for body in bodies) / holes.volume() - 1.0) <= _SMALLEST
    return united - holes if is_simple else None


def _overlaps(solid: manifold3d.Manifold) -> bool:
    """Return whether parts of a solid overlap.

    The volume of an intersection is the integral of the product of both winding numbers w. Where solids do not overlap,
    w^2 equals abs(w).
    """
    volume_mm3 = abs(solid.volume())
    return bool((solid ^ solid).volume() > (1.0 + _SMALLEST) * volume_mm3)


def _invert(shell: manifold3d.Manifold) -> manifold3d.Manifold:
    vertices_mm, faces = to_surface(shell)
    return to_manifold(vertices_mm, faces[:, ::-1])
