"""From the description of a specimen to one watertight solid in the canister's water, with its exact volume."""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import manifold3d
import numpy as np
import trimesh

from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.rsml import Root, read_rsml
from rhizotwin.scenes.schema import to_plain
from rhizotwin.scenes.specimens import GrownSpecimen, MeshSpecimen, RsmlSpecimen, SphereSpecimen
from rhizotwin.scenes.traits import measure_traits
from rhizotwin.sim import growth, meshes, solids
from rhizotwin.sim.solids import Array, Faces

SPHERE_SUBDIVISIONS = 6
"""81920 faces: 0.0024 % from the ball before it is scaled to the ball's volume."""
TOUCH_MM = 1e-6
"""A specimen may reach this far past wall, floor or surface: rounding."""


@dataclass(frozen=True, kw_only=True)
class SpecimenSolid:
    """One watertight solid in the canister frame."""

    vertices: Array
    """(V, 3) float64, mm."""
    faces: Faces
    """(F, 3) int32, counter-clockwise seen from outside."""
    volume_mm3: float
    """Exact volume of the polyhedron."""
    roots: tuple[Root, ...] = ()
    """Centrelines with final diameters; empty for spheres and meshes."""
    traits: dict[str, Any] = field(default_factory=dict)
    """Every field of `scenes.traits.Traits`."""
    notes: tuple[str, ...] = ()
    """What was repaired or is odd about the specimen, a sentence each, for the user."""

    @property
    def normals(self) -> Array:
        """Outward unit normals (V, 3) of the vertices."""
        return np.asarray(trimesh.Trimesh(self.vertices, self.faces, process=False).vertex_normals)

    @property
    def extents_min_mm(self) -> Array:
        """Lower corner (3,) of the bounding box."""
        lower: Array = self.vertices.min(axis=0)
        return lower

    @property
    def extents_max_mm(self) -> Array:
        """Upper corner (3,) of the bounding box."""
        upper: Array = self.vertices.max(axis=0)
        return upper


@dataclass(frozen=True, kw_only=True)
class Sleeve:
    """What the hairs of roots reach: a closed surface about them, in the canister frame."""

    vertices: Array
    """(V, 3) float64, mm."""
    faces: Faces
    """(F, 3) int32."""


def sleeve(solid: SpecimenSolid, hair_mm: float) -> Sleeve | None:
    """Return what hairs of some length reach about a specimen's roots; None where it has none."""
    if not solid.roots:
        return None
    grown = [replace(root, diameters_mm=root.diameters_mm + 2.0 * hair_mm) for root in solid.roots]
    vertices, faces = solids.surface_of(solids.union_of_roots(grown))
    return Sleeve(vertices=vertices, faces=faces)


def build_specimen(scene: Scene, *, folder: Path | None = None) -> SpecimenSolid:
    """Build the solid of a scene's specimen.

    Parameters
    ----------
    scene
        Its specimen, and the canister, water and net pot that hold it.
    folder
        Where relative paths of specimen files start; None: the working directory.

    Returns
    -------
    SpecimenSolid
        In the canister frame, wholly in the water.

    Raises
    ------
    UserError
        A file cannot be used, a volume cannot be reached, or the specimen leaves the water.
    """
    specimen = scene.specimen
    roots: list[Root] = []
    notes: list[str] = []
    if isinstance(specimen, SphereSpecimen):
        what = "the sphere"
        solid = _sphere(specimen)
    elif isinstance(specimen, MeshSpecimen):
        path = _locate(specimen.file, folder)
        what = str(path)
        solid, notes = meshes.load_solid(path)
    elif isinstance(specimen, RsmlSpecimen):
        path = _locate(specimen.file, folder)
        what = str(path)
        traced = read_rsml(path, unit=specimen.unit, diameter_mm=specimen.diameter_mm)
        check_in_water(np.concatenate([root.points_mm for root in traced]), scene, what=what)
        roots = list(traced)
        solid = solids.union_of_roots(roots)
        if (parts := len(solid.decompose())) > 1:
            notes.append(f"{what}: the roots make {parts} separate bodies; where the file leaves gaps, they are kept.")
    elif isinstance(specimen, GrownSpecimen):
        what = "the grown plant"
        roots = growth.grow(specimen, canister=scene.canister, net_pot=scene.net_pot)
        solid, roots, _ = solids.scale_to_volume(roots, 1000.0 * specimen.volume_ml)
    else:
        raise UserError(f"scene {scene.name!r} has no specimen: add a [specimen] to its file, or give one with --specimen FILE")
    vertices, faces = solids.surface_of(solid)
    check_in_water(vertices, scene, what=what)
    hidden_mm = float(vertices[:, 2].max()) - scene.net_pot.grid_z_mm
    if hidden_mm > TOUCH_MM:
        notes.append(f"{what}: its top {hidden_mm:.2f} mm are above the net pot's grid (z {scene.net_pot.grid_z_mm:g} mm) and never seen.")
    volume_mm3, surface_mm2 = float(solid.volume()), float(solid.surface_area())
    traits = to_plain(measure_traits(roots, vertices, volume_mm3=volume_mm3, surface_mm2=surface_mm2))
    return SpecimenSolid(vertices=vertices, faces=faces, volume_mm3=volume_mm3, roots=tuple(roots), traits=traits, notes=tuple(notes))


def check_in_water(vertices: Array, scene: Scene, *, what: str) -> None:
    """Refuse vertices (V, 3), in mm in the canister frame, outside the water: inner wall, floor, surface.

    Raises
    ------
    UserError
        Says which limit is passed, by how much and where.
    """
    canister = scene.canister
    radius_mm = np.hypot(vertices[:, 0], vertices[:, 1])
    past = {
        f"past the inner wall (radius {canister.inner_radius_mm:g} mm)": radius_mm - canister.inner_radius_mm,
        f"below the floor (z {canister.floor_z_mm:g} mm)": canister.floor_z_mm - vertices[:, 2],
        f"above the water's surface (z {scene.water.level_mm:g} mm)": vertices[:, 2] - scene.water.level_mm,
    }
    where, distances_mm = max(past.items(), key=lambda item: float(item[1].max()))
    worst = int(np.argmax(distances_mm))
    if distances_mm[worst] > TOUCH_MM:
        x, y, z = vertices[worst]
        raise UserError(
            f"The specimen leaves the water: {what} reaches {distances_mm[worst]:.2f} mm {where} at ({x:.1f}, {y:.1f}, {z:.1f}) mm; "
            "move or shrink it (millimetres, canister frame: z = 0 is the rim, the axis is x = y = 0)."
        )


def _locate(file: str, folder: Path | None) -> Path:
    path = Path(file).expanduser()
    return path if path.is_absolute() or folder is None else folder / path


def _sphere(specimen: SphereSpecimen) -> manifold3d.Manifold:
    ball = trimesh.creation.icosphere(subdivisions=SPHERE_SUBDIVISIONS, radius=1.0)
    unit = solids.manifold_of(np.asarray(ball.vertices), np.asarray(ball.faces, dtype=np.int32))
    grow = (4.0 / 3.0 * np.pi / unit.volume()) ** (1.0 / 3.0) * specimen.diameter_mm / 2.0
    return solids.manifold_of(grow * np.asarray(ball.vertices) + np.array(specimen.centre_mm), np.asarray(ball.faces, dtype=np.int32))
