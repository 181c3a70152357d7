"""Conversion of closed meshes to solids in which overlaps count once."""

from __future__ import annotations

from dataclasses import dataclass

import manifold3d
import numpy as np

from rhizotwin.recon.results.parts import Mesh
from rhizotwin.sim.overlaps import SMALLEST, relative_overlap, unite_overlaps
from rhizotwin.sim.solids import to_manifold, to_surface


@dataclass(frozen=True)
class MeshSolid:
    """Solid that a mesh bounds."""

    solid: manifold3d.Manifold
    """Solid without overlaps, mm."""
    was_united: bool
    """Whether parts of the mesh overlap and were united."""


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
    found_cavities = [unite_overlaps(_invert(shell)) for shell in shells if shell.volume() < 0.0]
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


def _invert(shell: manifold3d.Manifold) -> manifold3d.Manifold:
    vertices_mm, faces = to_surface(shell)
    return to_manifold(vertices_mm, faces[:, ::-1])
