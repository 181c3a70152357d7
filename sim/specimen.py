"""Build a watertight solid of a specimen in the canister's water.

Its volume is exact.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import manifold3d
import numpy as np
import trimesh

from rhizotwin.scenes import series
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.monitor import Monitor
from rhizotwin.scenes.plants import Plant
from rhizotwin.scenes.rsml import Root, length_mm
from rhizotwin.scenes.rsml_reader import RsmlFile, read_file
from rhizotwin.scenes.schema import to_plain
from rhizotwin.scenes.specimens import GrownSpecimen, MeshSpecimen, PlacedFile, RsmlSpecimen, Specimen, SphereSpecimen
from rhizotwin.scenes.thickened_roots import trim_buried
from rhizotwin.scenes.traced_roots import close_gaps, growth_direction, main_root, merge_shared_stretches
from rhizotwin.scenes.traits import measure_traits
from rhizotwin.sim import growth, meshes, placement, solids
from rhizotwin.sim.placement import TOUCH_MM, check_in_water
from rhizotwin.sim.shoot import ShootSolid, build_shoot
from rhizotwin.sim.solids import Array, Faces

SPHERE_SUBDIVISIONS = 6
"""Number of subdivisions of the icosahedron that approximates a sphere. After scaling to the volume of the ball, its
81920 faces deviate from the ball by at most 0.0045 % of the radius."""
MOST_SIDEWAYS = 0.5
"""Cosine of the angle between a main root and the vertical below which a note says that it runs sideways: 60 degrees.
Seminal roots of cereals grow at up to about 50 degrees."""
SCANNERS_DPI = (72.0, 75.0, 96.0, 100.0, 150.0, 200.0, 300.0, 400.0, 600.0, 800.0, 1200.0, 2400.0, 4800.0)
"""Common resolutions of scanners and screens, dots per inch. A resolution in a file that equals one of them is probably
in dots per inch."""


@dataclass(frozen=True, kw_only=True)
class SpecimenSolid:
    """Watertight solid of a specimen, canister frame."""

    vertices: Array
    """Vertices (V, 3), float64, mm."""
    faces: Faces
    """Faces (F, 3), int32, counter-clockwise as seen from outside."""
    volume_mm3: float
    """Exact volume of the polyhedron, mm3."""
    roots: tuple[Root, ...] = ()
    """Centre lines with final diameters. The tuple is empty for spheres and meshes."""
    traits: dict[str, Any] = field(default_factory=dict)
    """True traits, keyed by the field names of `scenes.traits.Traits`."""
    plants: dict[str, dict[str, Any]] = field(default_factory=dict)
    """Volume (``volume_mm3``) and ``traits`` of each plant, keyed by plant name. It is empty if there is a single
    plant."""
    notes: tuple[str, ...] = ()
    """Sentences for the user about repairs and unusual properties of the specimen."""
    shoot: ShootSolid | None = None
    """Shoot above the net pot. It is None if the scene has no shoot."""

    @property
    def normals(self) -> Array:
        """Outward unit normals of the vertices (V, 3)."""
        return np.asarray(trimesh.Trimesh(self.vertices, self.faces, process=False).vertex_normals)

    @property
    def extents_min_mm(self) -> Array:
        """Minimum x, y and z of the solid (3,), mm."""
        lower: Array = self.vertices.min(axis=0)
        return lower

    @property
    def extents_max_mm(self) -> Array:
        """Maximum x, y and z of the solid (3,), mm."""
        upper: Array = self.vertices.max(axis=0)
        return upper


@dataclass(frozen=True, kw_only=True)
class Sleeve:
    """Closed surface that encloses the roots and their root hairs, canister frame."""

    vertices: Array
    """Vertices (V, 3), float64, mm."""
    faces: Faces
    """Faces (F, 3), int32."""


def sleeve(solid: SpecimenSolid, hair_mm: float) -> Sleeve | None:
    """Return the surface that encloses the root hairs of a specimen.

    Its distance from the roots is the length of the hairs, mm. The result is None if the specimen has no roots.
    """
    if not solid.roots:
        return None
    grown = [replace(root, diameters_mm=root.diameters_mm + 2.0 * hair_mm) for root in solid.roots]
    vertices, faces = solids.to_surface(solids.unite_roots(grown))
    return Sleeve(vertices=vertices, faces=faces)


def build_specimen(scene: Scene, *, folder: Path | None = None, monitor: Monitor | None = None) -> SpecimenSolid:
    """Build the solid of a scene's specimen or plants.

    Parameters
    ----------
    scene : Scene
        Scene with specimen, canister, water and net pot.
    folder : path or None
        Base folder for relative paths of specimen files. None: working directory.
    monitor : Monitor, optional
        Progress monitor, which may cancel the work.

    Returns
    -------
    SpecimenSolid
        Solid, canister frame, that lies completely inside the water.

    Raises
    ------
    UserError
        If a file is invalid, the volume cannot be reached, or a part of the specimen is outside the water.
    """
    if scene.plants:
        parts = [_build_plant(plant, scene, folder, monitor) for plant in scene.plants]
        what = "the plants"
        solid = manifold3d.Manifold.batch_boolean([part.solid for part in parts], manifold3d.OpType.Add)
    else:
        if scene.specimen is None:
            raise UserError(f"scene {scene.name!r} has no specimen; add a section [specimen] to the scene file, or use --specimen FILE")
        parts = [_build_one(scene.specimen, scene, folder, monitor)]
        what, solid = parts[0].what, parts[0].solid
    roots, notes = _join_roots([part.roots for part in parts]), [note for part in parts for note in part.notes]
    vertices, faces = solids.to_surface(solid)
    check_in_water(vertices, scene, what=what)
    hidden_mm = float(vertices[:, 2].max()) - scene.net_pot.grid_z_mm
    if hidden_mm > TOUCH_MM:
        notes.append(
            f"{what}: the upper {hidden_mm:.2f} mm are above the net pot's grid (z {scene.net_pot.grid_z_mm:g} mm) and not visible."
        )
    return SpecimenSolid(
        vertices=vertices,
        faces=faces,
        volume_mm3=float(solid.volume()),
        roots=roots,
        traits=_traits(solid, roots),
        plants={
            plant.plant: {"volume_mm3": float(part.solid.volume()), "traits": _traits(part.solid, part.roots)}
            for plant, part in zip(scene.plants, parts, strict=False)
        },
        notes=tuple(notes),
        shoot=build_shoot(scene),
    )


@dataclass(frozen=True)
class _Part:
    """Specimen, or one of several plants, as a solid."""

    what: str
    """Name of the specimen for messages."""
    solid: manifold3d.Manifold
    """Solid, mm, canister frame."""
    roots: tuple[Root, ...] = ()
    """Centre lines with diameters."""
    notes: tuple[str, ...] = ()
    """Sentences for the user about the specimen."""


def _build_plant(plant: Plant, scene: Scene, folder: Path | None, monitor: Monitor | None) -> _Part:
    """Build one of several plants, at its position in the net pot."""
    specimen = plant.placed()
    if specimen is None:
        raise UserError(
            f"plant {plant.plant} of scene {scene.name!r} has no specimen; add a section [plants.specimen] below its [[plants]]"
        )
    part = _build_one(specimen, scene, folder, monitor)
    return replace(part, what=f"plant {plant.plant}", roots=tuple(replace(root, plant=plant.plant) for root in part.roots))


def _join_roots(parts: Sequence[tuple[Root, ...]]) -> tuple[Root, ...]:
    """Concatenate the roots of several specimens.

    The indices of their parents are adapted.
    """
    roots: list[Root] = []
    for part in parts:
        first = len(roots)
        roots += [replace(root, parent=root.parent + first if root.parent >= 0 else -1) for root in part]
    return tuple(roots)


def _traits(solid: manifold3d.Manifold, roots: Sequence[Root]) -> dict[str, Any]:
    """Measure the traits of a solid and its roots, and return them as a JSON object."""
    vertices, _ = solids.to_surface(solid)
    measured: dict[str, Any] = to_plain(
        measure_traits(roots, vertices, volume_mm3=float(solid.volume()), surface_mm2=float(solid.surface_area()))
    )
    return measured


def _build_one(specimen: Specimen, scene: Scene, folder: Path | None, monitor: Monitor | None) -> _Part:
    """Build a single specimen according to its type."""
    if isinstance(specimen, SphereSpecimen):
        return _Part("the sphere", _sphere(specimen))
    if isinstance(specimen, GrownSpecimen):
        grown, volume_ml = _grow(specimen, scene)
        solid, grown, _ = solids.scale_to_volume(grown, 1000.0 * volume_ml, monitor=monitor)
        return _Part("the grown plant", solid, tuple(grown))
    path = _locate(specimen.file, folder)
    what = str(path)
    if isinstance(specimen, MeshSpecimen):
        solid, notes = meshes.load_solid(path)
        solid = _place_mesh(solid, specimen, scene)
        if _is_moved(specimen):
            notes.append(f"{what}: {placement.format_size(solids.to_surface(solid)[0])} mm (x, y, z) after placement.")
        return _Part(what, solid, (), tuple(notes))
    roots, notes = _load_traced_roots(path, specimen, scene)
    solid = solids.unite_roots(roots, monitor=monitor)
    roots, shared_mm = merge_shared_stretches(roots)
    if shared_mm > 0.0:
        notes.append(f"{what}: {shared_mm:.0f} mm of centre lines are shared by several roots and counted once.")
    whole_mm, roots = length_mm(roots), trim_buried(roots)
    if (buried_mm := whole_mm - length_mm(roots)) > 0.5:
        notes.append(f"{what}: {buried_mm:.0f} mm of laterals deep inside thickened parents are not counted.")
    if (bodies := len(solid.decompose())) > 1:
        notes.append(f"{what}: the roots form {bodies} separate bodies, because gaps in the file are not closed.")
    return _Part(what, solid, tuple(replace(root, plant="") for root in roots), tuple(notes))


def _grow(specimen: GrownSpecimen, scene: Scene) -> tuple[list[Root], float]:
    """Grow a plant in the nutrient solution of a scene, and return its roots and its volume in ml.

    If the nutrient solution limits the growth, radii have the same scale as without limitation.
    """
    factor = series.limitation(specimen, scene.solution.ions_mmol_per_l)
    grown = growth.grow(specimen, canister=scene.canister, net_pot=scene.net_pot)
    if factor == 1.0:
        return grown, specimen.volume_ml
    limited = [] if factor == 0.0 else growth.grow(series.scale_growth(specimen, factor), canister=scene.canister, net_pot=scene.net_pot)
    if not limited:
        raise UserError(
            f"the roots of scene {scene.name!r} do not grow, because its nutrient solution contains too little of "
            f"{', '.join(specimen.half_growth_mmol_per_l)}; increase the concentrations"
        )
    return limited, specimen.volume_ml * series.tube_mm3(limited) / series.tube_mm3(grown)


def _is_moved(specimen: PlacedFile) -> bool:
    return specimen.place != "given" or specimen.flip or specimen.scale != 1.0 or any(specimen.shift_mm)


def _place_mesh(solid: manifold3d.Manifold, specimen: MeshSpecimen, scene: Scene) -> manifold3d.Manifold:
    """Transform a mesh as the scene specifies."""
    if not _is_moved(specimen):
        return solid
    vertices, faces = solids.to_surface(solid)
    return solids.to_manifold(placement.find_placement(specimen, vertices, scene).of(vertices), faces)


def _load_traced_roots(path: Path, specimen: RsmlSpecimen, scene: Scene) -> tuple[tuple[Root, ...], list[str]]:
    """Read traced roots from a file and place them.

    Return them with notes on how the file was interpreted.
    """
    file = read_file(path, unit=specimen.unit, diameter_mm=specimen.diameter_mm)
    roots, closed = close_gaps(file)
    growth_mm = growth_direction(main_root(roots))
    drawn_upright = file.dimensions == 2 and specimen.vertical_axis == "y"  # the reader has set the drawing upright
    axis = None if drawn_upright else specimen.vertical_axis
    placed = placement.find_placement(specimen, _extreme_points(roots), scene, growth_mm=growth_mm, vertical_axis=axis)
    roots = placed.roots(roots)
    reach_mm = _extreme_points(roots)
    doubt = file.doubt_unit(roots, reach_mm)
    try:
        check_in_water(reach_mm, scene, what=str(path))
    except UserError as error:
        if doubt is None:
            raise
        raise UserError(f"{path}: {doubt}") from error
    diameters_mm = np.concatenate([root.diameters_mm for root in roots])
    said = "specified unit" if specimen.unit else f"the file's unit {file.unit or 'is in its functions'}"
    resolution = f", resolution {file.resolution}" if file.resolution not in ("", "1", "1.0") else ""
    notes = [
        f"{path}: {len(roots)} roots, {placement.format_size(reach_mm)} mm (x, y, z), "
        f"{diameters_mm.min():.2g} to {diameters_mm.max():.2g} mm thick; "
        f"one unit of the coordinates in the file is {file.step_mm:.4g} mm ({said}{resolution})."
    ]
    notes += file.notes
    if doubt is not None:
        notes.append(f"{path}: {doubt}")
    elif resolution and _is_dpi(file):
        notes.append(
            f"{path}: the resolution of {file.resolution} is interpreted as coordinate units per {file.unit}. "
            f"If it is in dots per inch, set the unit '{25.4 / float(file.resolution):.4g} mm'."
        )
    if closed:
        notes.append(f"{path}: {closed} roots that begin at a distance from their parents were connected to nodes of their parents.")
    if (sideways := _sideways_note(placed.turn, growth_mm, "xyy" if file.dimensions == 2 else "xyz")) is not None:
        notes.append(f"{path}: {sideways}")
    return roots, notes


def _sideways_note(turn: Array, growth_mm: Array, axes: str) -> str | None:
    """Return a sentence if the main root runs sideways, with the axis of the file along which it runs.

    Parameters
    ----------
    turn : (3, 3) float64
        Rotation from the frame of the file to that of the canister.
    growth_mm : (3,) float64
        Vector from the base of the main root to its centre, in the frame of the file.
    axes : str
        Names of the axes in the file.
    """
    length_mm = float(np.linalg.norm(growth_mm))
    along_vertical = abs(float((turn @ growth_mm)[2])) / max(length_mm, 1e-12)
    if length_mm == 0.0 or along_vertical >= MOST_SIDEWAYS:
        return None
    axis = axes[int(np.abs(growth_mm).argmax())]
    return (
        f"the main root runs sideways, {np.degrees(np.arccos(along_vertical)):.0f} degrees from the vertical. If the axis {axis} of the "
        f"file is vertical, set --vertical-axis {axis}."
    )


def _is_dpi(file: RsmlFile) -> bool:
    """Return whether a resolution per centimetre or millimetre is probably in dots per inch.

    It is if its value is a common resolution of scanners.
    """
    return file.unit.lower() in ("cm", "mm") and float(file.resolution) in SCANNERS_DPI


def _extreme_points(roots: Sequence[Root]) -> Array:
    """Return the extreme points of roots along each axis (6 N, 3), mm.

    They lie on both sides of each of the N nodes, at the distance of the root's radius.
    """
    points_mm = np.concatenate([root.points_mm for root in roots])
    radii_mm = np.concatenate([root.diameters_mm for root in roots]) / 2.0
    ways = np.concatenate([np.eye(3), -np.eye(3)])
    return np.asarray((points_mm[:, None] + radii_mm[:, None, None] * ways).reshape(-1, 3))


def _locate(file: str, folder: Path | None) -> Path:
    path = Path(file).expanduser()
    return path if path.is_absolute() or folder is None else folder / path


def _sphere(specimen: SphereSpecimen) -> manifold3d.Manifold:
    ball = trimesh.creation.icosphere(subdivisions=SPHERE_SUBDIVISIONS, radius=1.0)
    unit = solids.to_manifold(np.asarray(ball.vertices), np.asarray(ball.faces, dtype=np.int32))
    grow = (4.0 / 3.0 * np.pi / unit.volume()) ** (1.0 / 3.0) * specimen.diameter_mm / 2.0
    return solids.to_manifold(grow * np.asarray(ball.vertices) + np.array(specimen.centre_mm), np.asarray(ball.faces, dtype=np.int32))
