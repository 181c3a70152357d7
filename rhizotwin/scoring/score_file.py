"""Comparison of the output of other methods with the ground truth of a simulated dataset."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from rhizotwin.recon import surface_sample
from rhizotwin.recon.hull import surface
from rhizotwin.recon.hull.leaves import Grid
from rhizotwin.recon.hull.leaves import Leaves as HullLeaves
from rhizotwin.recon.results.parts import Leaves, Mesh
from rhizotwin.scenes.dataset import Dataset, load_dataset
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.rsml import Root
from rhizotwin.scenes.rsml_reader import read_file, read_rsml
from rhizotwin.scenes.thickened_roots import trim_buried
from rhizotwin.scenes.traced_roots import close_gaps
from rhizotwin.scenes.traits import Traits, measure_traits
from rhizotwin.scenes.truth import Truth, load_truth
from rhizotwin.scoring import foreign_files, surface_distance
from rhizotwin.scoring.conventions import Convention, check_unit, convention_of, note_on
from rhizotwin.scoring.foreign_files import Stated
from rhizotwin.scoring.registration import register
from rhizotwin.scoring.score import plain, truth_mesh_path
from rhizotwin.scoring.score_roots import RootScore, compare_roots
from rhizotwin.scoring.score_shape import SURFACE_SAMPLES, SurfaceScore, compare_surfaces, compare_voxels
from rhizotwin.scoring.score_solid import percent, surface_rows, table_of
from rhizotwin.scoring.score_topology import TopologyScore, compare_topology
from rhizotwin.scoring.score_traits import compare_traits
from rhizotwin.stored import result_files

Floats = NDArray[np.float64]

OF_CENTRE_LINES = (
    "total_length",
    "mean_diameter",
    "median_diameter",
    "max_diameter",
    "roots",
    "tips",
    "branch_points",
    "branch_distance",
    "lateral_density",
    "tortuosity",
    "max_root_count",
    "median_root_count",
    "angle_to_gravity",
    "angle_to_parent",
)
"""Names of the traits that can be computed from centre lines with diameters."""
ALPHA = 0.1
"""Probability, according to the method, that a 90 % interval does not contain the true value."""
_MOST_COLUMNS = 25_000_000
"""Maximum number of columns of voxels below the bounding box of the true solid. Their table needs 0.8 GB of memory."""


@dataclass(frozen=True, kw_only=True)
class StatedScore:
    """Reported value of a trait compared with the ground truth."""

    value: float
    """Value that the method reports, in the unit of the trait."""
    true: float
    """True value in the trait's unit."""
    error: float
    """Relative error (found / true - 1). For an angle it is the difference in degrees."""
    interval: tuple[float, float] | None = None
    """90 % interval that the method reports. It is None if the method reports no interval."""
    holds: bool | None = None
    """Whether the interval contains the true value. It is None if there is no interval."""
    interval_score: float | None = None
    """Interval score of the 90 % interval (Gneiting and Raftery 2007), divided by the true value. It is the width of
    the interval, plus a penalty if the interval does not contain the true value. A smaller score is better. It is None
    if there is no interval."""


@dataclass(frozen=True, kw_only=True)
class FileScore:
    """Agreement of the output file of another method with the ground truth. Relative errors are (found / true - 1)."""

    file: str
    """Path of the output file."""
    scene: str
    """Name of the scene."""
    volume_mm3: float | None = None
    """Volume of the output, mm3. It is None if the output has no defined volume."""
    volume_true_mm3: float
    """True volume of the specimen, mm3."""
    volume_error: float | None = None
    """Relative error of the volume. It is None if the output has no defined volume."""
    extents_error: tuple[float, float, float] | None = None
    """Relative errors of the bounding box along x, y and z. They are None for centre lines and for tables of traits."""
    iou: float | None = None
    """Intersection over union of the volumes. It is exact for a closed mesh that does not fold into itself; parts that
    overlap are united. For other closed meshes and for voxel arrays it is computed from voxels. Otherwise it
    is None."""
    surface: SurfaceScore | None = None
    """Distances between the surface of the output and the true surface. It is None if the output has no surface."""
    roots: RootScore | None = None
    """Agreement of the centre lines with the true centre lines. It is None if the output has no centre lines."""
    topology: TopologyScore | None = None
    """Agreement of the branching with the true branching. It is None if the output has no centre lines."""
    traits: dict[str, StatedScore]
    """Errors of the traits, keyed by trait name."""
    notes: tuple[str, ...] = ()
    """Sentences about values that could not be computed."""

    def to_dict(self) -> dict[str, Any]:
        """Convert the score to values that the json module can write. Infinite values become None."""
        return {key: plain(value) for key, value in asdict(self).items()}

    def table(self) -> str:
        """Return the score as a text table."""
        rows: list[tuple[str, str]] = []
        if self.volume_mm3 is not None and self.volume_error is not None:
            rows.append(
                ("volume", f"{self.volume_mm3 / 1000.0:.5g} ml, true {self.volume_true_mm3 / 1000.0:.5g} ml: {percent(self.volume_error)}")
            )
        if self.extents_error is not None:
            rows += [(f"extent {axis}", percent(error)) for axis, error in zip("xyz", self.extents_error, strict=True)]
        if self.iou is not None:
            rows.append(("IoU", f"{self.iou:.4f}"))
        if self.surface is not None:
            rows += surface_rows(self.surface)
        if self.roots is not None:
            r = self.roots
            rows += [
                ("length", f"{r.length_mm:.1f} mm, true {r.length_true_mm:.1f} mm: {percent(r.length_error)}"),
                ("  centre lines", f"recall {r.recall:.4f}, precision {r.precision:.4f}, median distance {r.distance_median_mm:.3f} mm"),
                ("  tips", f"{r.tips}, true {r.tips_true}: recall {r.tip_recall:.3f}, precision {r.tip_precision:.3f}"),
            ]
        if self.topology is not None:
            rows += self.topology.rows()
        for name, one in self.traits.items():
            held = (
                ""
                if one.holds is None
                else f", interval {'contains' if one.holds else 'does not contain'} the true value, interval score {one.interval_score:.3f}"
            )
            error = f"{one.error:+.2f} deg" if name.startswith("angle") else percent(one.error)
            rows.append((name, f"{one.value:.5g}, true {one.true:.5g}: {error}{held}"))
        return "\n".join(
            [table_of(f"{self.file}, compared with the ground truth of {self.scene}", rows), *(f"note: {note}" for note in self.notes)]
        )


def score_mesh(file: Path | str, dataset: Dataset | Path | str, *, registered: bool = False) -> FileScore:
    """Score a triangle mesh: volume, extents, intersection over union and surface distances.

    Parameters
    ----------
    file : path
        PLY, STL or OBJ in mm with z up, or GLB in metres with y up.
    dataset : Dataset or path
        Simulated dataset, or the dataset's folder.
    registered : bool
        Whether the mesh is first registered to the true solid. Otherwise its coordinates are in the canister frame.

    Raises
    ------
    UserError
        If the file cannot be read or is in another unit, or the dataset has no ground truth.
    """
    from rhizotwin.scoring.mesh_solid import compare_volumes  # imports the simulator

    known = _Known.of(dataset)
    mesh = foreign_files.read_shape(Path(file))
    convention = Convention()
    if registered:
        check_unit(mesh, known.solid, where=str(file))
        mesh = register(mesh, known.solid).moved
    else:
        convention = convention_of(_sample(mesh), _sample(known.solid), where=str(file))
        mesh = _converted(mesh, convention)
    volume_mm3, iou, notes = compare_volumes(mesh, known.solid)
    return replace(
        known.score(file, volume_mm3),
        extents_error=known.extents_error(mesh.vertices_mm[np.unique(mesh.faces)]),
        iou=iou,
        surface=compare_surfaces(mesh, known.solid),
        notes=(*note_on(convention), *notes),
    )


def score_voxels(file: Path | str, dataset: Dataset | Path | str) -> FileScore:
    """Score voxel occupancies in an NRRD or NPZ file.

    The file is read with `foreign_files.read_voxels`. The measures are those of `score_mesh`.
    """
    known = _Known.of(dataset)
    leaves, array = foreign_files.read_voxels(Path(file))
    if not len(leaves.low):
        return replace(known.score(file, 0.0), iou=0.0, notes=("no voxel is occupied",))
    grid = Grid(leaves.origin_mm, leaves.voxel_mm, 0, (1, 1, 1))
    mesh = Mesh.of(surface.surface(HullLeaves(grid, leaves.low, leaves.size, leaves.occupancy)))
    centres_mm = leaves.origin_mm + leaves.voxel_mm * (leaves.low + 0.5)
    box_mm = leaves.origin_mm, leaves.voxel_mm * np.array(array, np.float64)
    convention = convention_of(mesh.vertices_mm if len(mesh.faces) else centres_mm, _sample(known.solid), box=box_mm, where=str(file))
    leaves, mesh = _converted_leaves(leaves, convention), _converted(mesh, convention)
    known.check_voxels(leaves.voxel_mm, where=str(file))
    scored = replace(
        known.score(file, float(leaves.occupancy.sum(dtype=np.float64)) * leaves.voxel_mm**3),
        iou=compare_voxels(leaves, leaves, known.solid)[0].iou_weighted,
        notes=note_on(convention),
    )
    if not len(mesh.faces):
        return replace(scored, notes=(*scored.notes, "the output has no surface, because no voxel is at least half occupied"))
    return replace(scored, extents_error=known.extents_error(mesh.vertices_mm), surface=compare_surfaces(mesh, known.solid))


def score_points(file: Path | str, dataset: Dataset | Path | str) -> FileScore:
    """Score surface points by their distances to the true surface, and the true surface by its distances to the points.

    The points are read from a PLY file, or from a text file with x, y and z in each line.
    """
    known = _Known.of(dataset)
    points = foreign_files.read_points(Path(file))
    vertices, faces = known.solid.vertices_mm, known.solid.faces
    on_truth = _sample(known.solid)
    convention = convention_of(points, on_truth, where=str(file))
    points = convention.convert(points)
    some = points[np.random.default_rng(0).permutation(len(points))[:SURFACE_SAMPLES]]
    to_truth = surface_distance.distances(some, vertices, faces)
    to_points = cKDTree(points).query(on_truth)[0]
    return replace(
        known.score(file),
        extents_error=known.extents_error(points),
        surface=SurfaceScore.of(to_truth, to_points),
        notes=note_on(convention),
    )


def score_rsml(file: Path | str, dataset: Dataset | Path | str) -> FileScore:
    """Score centre lines in an RSML file: length, recall, precision, tips, parents, orders and derived traits.

    Raises
    ------
    UserError
        If the file cannot be read, or the dataset has no true centre lines.
    """
    known = _Known.of(dataset)
    foreign = read_file(Path(file))
    roots, closed = close_gaps(foreign)
    roots = trim_buried(roots)  # as those of the specimen
    if not known.roots:
        raise UserError(f"{known.folder}: the specimen has no true centre lines with which an RSML file could be compared")
    doubt = foreign.doubt_unit(roots, np.concatenate([root.points_mm for root in roots]))
    notes = [*foreign.notes, *([f"{file}: {doubt}"] if doubt else [])]
    if closed:
        notes.append(f"{closed} roots that begin at a distance from their parents were connected to nodes of their parents")
    compared = compare_traits(_traits_of(roots), _traits_of(known.roots))
    traits = {
        name: StatedScore(value=float(one.found), true=float(one.true), error=one.error)
        for name, one in compared.items()
        if name in OF_CENTRE_LINES and one.error is not None
    }
    return replace(
        known.score(file),
        roots=compare_roots(roots, known.roots),
        topology=compare_topology(roots, known.roots),
        traits=traits,
        notes=tuple(notes),
    )


def score_traits(file: Path | str, dataset: Dataset | Path | str) -> FileScore:
    """Score a table of traits in a CSV file by its values and 90 % intervals.

    The file is read with `foreign_files.read_traits`.
    """
    known = _Known.of(dataset)
    stated = foreign_files.read_traits(Path(file))
    true = known.traits()
    traits = {name: _score_stated(name, one, true[name]) for name, one in stated.items() if true.get(name) is not None}
    volume = stated.get("volume")
    return replace(known.score(file, None if volume is None else volume.value), traits=traits)


def interval_score(interval: tuple[float, float], true: float) -> float:
    """Return the interval score of a 90 % interval, divided by the true value (Gneiting and Raftery 2007, eq. 43)."""
    low, high = interval
    return ((high - low) + 2.0 / ALPHA * (max(low - true, 0.0) + max(true - high, 0.0))) / abs(true)


@dataclass(frozen=True)
class _Known:
    """Ground truth of a dataset."""

    folder: Path
    scene: str
    truth: Truth
    solid: Mesh
    roots: tuple[Root, ...]

    @staticmethod
    def of(dataset: Dataset | Path | str) -> _Known:
        loaded = dataset if isinstance(dataset, Dataset) else load_dataset(dataset)
        mesh_path = truth_mesh_path(loaded.folder)
        skeleton = mesh_path.parent / "skeleton.rsml"
        return _Known(
            loaded.folder,
            loaded.scene.name,
            load_truth(loaded.folder),
            result_files.read_mesh(mesh_path),
            read_rsml(skeleton) if skeleton.is_file() else (),
        )

    def score(self, file: Path | str, volume_mm3: float | None = None) -> FileScore:
        """Return the score of a file of which only the volume, mm3, is known."""
        true_mm3 = self.truth.volume_mm3
        error = None if volume_mm3 is None else volume_mm3 / true_mm3 - 1.0
        return FileScore(file=str(file), scene=self.scene, volume_mm3=volume_mm3, volume_true_mm3=true_mm3, volume_error=error, traits={})

    def extents_error(self, points_mm: Floats) -> tuple[float, float, float]:
        """Return the relative errors of the size of a bounding box along x, y and z.

        The box encloses points (N, 3), mm.
        """
        size = np.ptp(points_mm, axis=0) / np.ptp(self.solid.vertices_mm, axis=0) - 1.0
        return float(size[0]), float(size[1]), float(size[2])

    def check_voxels(self, voxel_mm: float, *, where: str) -> None:
        """Raise `UserError` if voxels are larger than the true solid, or too small for its comparison."""
        size_mm = np.ptp(self.solid.vertices_mm, axis=0)
        least_mm = float(np.sqrt(size_mm[0] * size_mm[1] / _MOST_COLUMNS))
        most_mm = float(size_mm.max())
        if not least_mm <= voxel_mm <= most_mm:
            raise UserError(
                f"{where}: the voxel size is {voxel_mm:g} mm, but must be {least_mm:.2g} to {most_mm:.3g} mm for a specimen "
                f"of {' x '.join(f'{size:.3g}' for size in size_mm)} mm; check the voxel size and its unit"
            )

    def traits(self) -> dict[str, float | None]:
        """Return the true values of the scalar traits, keyed by trait name (see `scenes.trait_table`)."""
        volume_mm3 = self.truth.volume_mm3
        surface_mm2 = float(self.solid.areas_mm2.sum())
        measured = measure_traits(self.roots, self.solid.vertices_mm, volume_mm3=volume_mm3, surface_mm2=surface_mm2)
        return {name: one.true for name, one in compare_traits(measured, measured).items() if not isinstance(one.true, list)}


def _sample(mesh: Mesh) -> Floats:
    """Return random points (N, 3) on a mesh, mm, which are the same in each call."""
    return surface_sample.sample(mesh.vertices_mm, mesh.faces, count=SURFACE_SAMPLES, rng=np.random.default_rng(0))[0]


def _converted(mesh: Mesh, convention: Convention) -> Mesh:
    is_mirrored = np.linalg.det(convention.axes) < 0.0
    return Mesh(vertices_mm=convention.convert(mesh.vertices_mm), faces=mesh.faces[:, ::-1] if is_mirrored else mesh.faces)


def _converted_leaves(leaves: Leaves, convention: Convention) -> Leaves:
    low = np.round((leaves.low + 0.5) @ np.transpose(convention.axes) - 0.5).astype(np.int32)
    return replace(leaves, low=low, origin_mm=convention.convert(leaves.origin_mm[None])[0])


def _traits_of(roots: Sequence[Root]) -> Traits:
    """Measure the traits of centre lines.

    Volume and surface area are unknown. They are set to 1, and traits that depend on them are not used.
    """
    return measure_traits(roots, np.concatenate([root.points_mm for root in roots]), volume_mm3=1.0, surface_mm2=1.0)


def _score_stated(name: str, one: Stated, true: float | None) -> StatedScore:
    known = float(true or 0.0)
    error = one.value - known if name.startswith("angle") else one.value / known - 1.0 if known else math.nan
    scored = StatedScore(value=one.value, true=known, error=error, interval=one.interval)
    if one.interval is None:
        return scored
    low, high = one.interval
    return replace(scored, holds=low <= known <= high, interval_score=interval_score(one.interval, known) if known else None)
