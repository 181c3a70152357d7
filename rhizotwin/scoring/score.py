"""Comparison of a reconstruction with the ground truth of a simulated dataset.

The reconstruction itself never reads the ``truth`` folder.
"""

import html
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from rhizotwin.recon.results.parts import Json, Mesh
from rhizotwin.recon.results.result import Result, Triple, triple
from rhizotwin.scenes.dataset import Dataset, load_dataset
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.rsml import Root
from rhizotwin.scenes.rsml_reader import read_rsml
from rhizotwin.scenes.traits import Traits, measure_traits
from rhizotwin.scenes.truth import load_truth
from rhizotwin.scoring import score_traits
from rhizotwin.scoring.score_plants import PlantScore, compare_plants
from rhizotwin.scoring.score_rig import RigError, compare_rig
from rhizotwin.scoring.score_roots import RootScore, compare_roots
from rhizotwin.scoring.score_shape import HullScore, SurfaceScore, VoxelScore, compare_surfaces, compare_voxels
from rhizotwin.scoring.score_shoot import ShootScore, compare_shoot
from rhizotwin.scoring.score_solid import (
    VolumeScore,
    extent_rows,
    percent,
    surface_rows,
    table_of,
    volume_fields,
    volume_rows,
)
from rhizotwin.scoring.score_topology import TopologyScore, compare_topology
from rhizotwin.scoring.score_traits import TraitScore, compare_traits
from rhizotwin.scoring.score_views import MaskScore, PoseScore, compare_masks, compare_poses
from rhizotwin.stored import result_files
from rhizotwin.stored.load import load_result

_IMPORTANT = {
    "volume",
    "  90 % interval",
    "  trusted",
    "length",
    "  tips",
    "tree",
    "  ghosts",
    "voxels",
    "surface distance",
    "  camera positions",
}
"""Names of the rows that are shown first."""


@dataclass(frozen=True, kw_only=True)
class Score(VolumeScore):
    """Agreement of a result with the ground truth, for the whole shape and for each stage of the reconstruction.

    Relative errors are (found / true - 1).
    """

    voxel_mm: float
    """Edge of a voxel of the result, mm."""
    extents_mm: Triple
    """Size of the result's bounding box along x, y and z of the canister frame, mm."""
    extents_true_mm: Triple
    """Size of the true bounding box along x, y and z of the canister frame, mm."""
    extents_error: Triple
    """Relative errors of the bounding box along x, y and z."""
    extents_error_max: float
    """Maximum absolute relative error of the bounding box along x, y and z."""
    voxels: VoxelScore
    """Agreement of the occupied voxels with the true solid."""
    surface: SurfaceScore
    """Distances between the surface of the result and the true surface."""
    poses: PoseScore | None
    """Errors of the camera poses. It is None if no view was used."""
    rig: tuple[RigError, ...]
    """Errors of the calibrated rig parameters. Parameters whose true values are unknown are omitted."""
    masks: MaskScore | None
    """Errors of the silhouettes. It is None if the result contains no silhouettes."""
    hull: HullScore
    """Agreement of the visual hull with the true solid."""
    roots: RootScore | None
    """Agreement of the centre lines with the true centre lines. It is None if the truth or the result has no roots."""
    topology: TopologyScore | None
    """Agreement of the tree with the true tree. It is None if the truth or the result has no roots."""
    plants: tuple[PlantScore, ...]
    """Scores of the plants, if the canister contains several. The tuple is empty for a single plant."""
    shoot: ShootScore | None
    """Agreement of the shoot with the true shoot. It is None if the truth or the result has no shoot."""
    traits: dict[str, TraitScore]
    """Errors of the traits, keyed by trait name (see `scenes.trait_table`)."""
    blind_mm3: float
    """Volume of the water that is visible in too few views to be reconstructed, mm3."""
    timings_s: dict[str, float]
    """Duration of each stage of the reconstruction, s."""
    peak_memory_mib: float | None
    """Maximum memory of the reconstruction, MiB. It is None if the memory was not measured."""
    warnings: tuple[str, ...]
    """Warnings of the reconstruction."""

    def to_dict(self) -> Json:
        """Convert the score to values that the json module can write.

        The fields of ``voxels`` are at the top level. Infinite values become None.
        """
        found = asdict(self)
        voxels = found.pop("voxels")
        found = {**found, **voxels}
        return {key: plain(value) for key, value in found.items()}

    def __repr__(self) -> str:
        """Return the most important numbers as a text table."""
        return self.table(every=False)

    def _repr_html_(self) -> str:
        """Return the text table as HTML for notebooks."""
        return f"<pre>{html.escape(self.table())}</pre>"

    def table(self, *, every: bool = True) -> str:
        """Return a text table of ``every`` number, or of the most important ones and the number of others."""
        shoot = [] if self.shoot is None else self.shoot.rows()
        plants = [row for plant in self.plants for row in plant.rows()]
        rows = [*self._shape_rows(), *plants, *shoot, ("traits", ""), *score_traits.rows(self.traits), *self._stage_rows()]
        shown = rows if every else [row for row in (*self._shape_rows(), *self._stage_rows()) if row[0] in _IMPORTANT]
        title = f"{self.scene}, voxels of {self.voxel_mm:g} mm, compared with the ground truth"
        rest = [] if every else [f"... {len(rows) - len(shown)} more lines: rhizotwin score --all, or print(score.table())"]
        return "\n".join([table_of(title, shown), *rest, *(f"warning: {warning}" for warning in self.warnings)])

    def _shape_rows(self) -> list[tuple[str, str]]:
        rows = [*volume_rows(self), *extent_rows(self.extents_mm, self.extents_true_mm, self.extents_error)]
        v = self.voxels
        if self.roots is not None:
            r = self.roots
            rows += [
                ("length", f"{r.length_mm:.1f} mm, true {r.length_true_mm:.1f} mm: {percent(r.length_error)}"),
                ("  centre lines", f"recall {r.recall:.4f}, precision {r.precision:.4f}, median distance {r.distance_median_mm:.3f} mm"),
                ("  radii", f"median error {percent(r.radius_error_median)}"),
                ("  tips", f"{r.tips}, true {r.tips_true}: recall {r.tip_recall:.3f}, precision {r.tip_precision:.3f}"),
            ]
        return [
            *rows,
            *(self.topology.rows() if self.topology is not None else ()),
            ("voxels", f"recall {v.recall:.4f}, precision {v.precision:.4f}, IoU {v.iou:.4f}"),
            ("  by volume", f"recall {v.recall_weighted:.4f}, precision {v.precision_weighted:.4f}, IoU {v.iou_weighted:.4f}"),
            *surface_rows(self.surface),
        ]

    def _stage_rows(self) -> list[tuple[str, str]]:
        rows: list[tuple[str, str]] = [("by stage", "")]
        if self.poses is not None:
            p = self.poses
            rows += [
                ("  cameras", f"{p.used} used, {p.left_out} not used"),
                ("  camera positions", f"median {p.median_mm:.4f} mm, maximum {p.max_mm:.4f} mm"),
                ("  camera directions", f"median {p.median_deg:.4f} deg, maximum {p.max_deg:.4f} deg"),
                ("  common error", f"{p.common_mm:.4f} mm at the specimen, {p.common_deg:.4f} deg; remaining per view {p.own_mm:.4f} mm"),
            ]
        rows += [(f"  {error.quantity}", error.text) for error in self.rig]
        if self.masks is not None:
            m = self.masks
            rows += [
                ("  silhouettes", f"area {percent(m.area_error)}, IoU {m.iou:.4f}, mean error {100.0 * m.mean_abs:.2f} % of the area"),
                ("  unusable pixels", f"{100.0 * m.unseen:.2f} % of the true area"),
            ]
        h = self.hull
        rows += [
            ("  hull", f"{h.volume_mm3:.1f} mm3: {percent(h.volume_error)}; contains {100.0 * h.recall:.2f} % of the truth"),
            ("  trimmed", f"contains {100.0 * h.kept_recall:.2f} % of the truth"),
            ("  counting voxels", f"{h.leaf_count_volume_mm3:.1f} mm3: {percent(h.leaf_count_volume_mm3 / self.volume_true_mm3 - 1.0)}"),
            ("  blind", f"{self.blind_mm3:.1f} mm3 of the water is visible in too few views"),
            ("  time", ", ".join(f"{stage} {seconds:.1f} s" for stage, seconds in self.timings_s.items())),
        ]
        if self.peak_memory_mib is not None:
            rows.append(("  memory", f"at most {self.peak_memory_mib:.0f} MiB"))
        return rows


def plain(value: Any) -> Any:
    """Convert a value to types that the json module can write. Infinite numbers and NaN become None."""
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else None
    return value


def truth_mesh_path(dataset_folder: Path) -> Path:
    """Return the path of the true solid's mesh in a simulated dataset.

    Raise an error if the dataset has no ground truth.
    """
    truth_folder = Path(dataset_folder) / "truth"
    if not truth_folder.is_dir():
        raise UserError(f"{dataset_folder} contains no ground truth; use a simulated dataset, or compare with a known solid or volume")
    return truth_folder / "specimen.ply"


def score(result: Result | Path | str, dataset: Dataset | Path | str) -> Score:
    """Compare a result with the ground truth of its dataset.

    Parameters
    ----------
    result : Result or path
        Result, or the result's folder.
    dataset : Dataset or path
        Simulated dataset of the result, or the dataset's folder.

    Raises
    ------
    UserError
        If the dataset has no ground truth or is not that of the result, or a file is missing or damaged.
    """
    where = "the result" if isinstance(result, Result) else str(result)
    found = result if isinstance(result, Result) else load_result(result)
    dataset = dataset if isinstance(dataset, Dataset) else load_dataset(dataset)
    mesh_path = truth_mesh_path(dataset.folder)
    result_files.check_same_scan(found.dataset_sha256, found.scene, where, dataset)
    truth = load_truth(dataset.folder)
    true_solid = result_files.read_mesh(mesh_path)
    solid = found.solid

    extents_mm = np.subtract(solid.extents_max_mm, solid.extents_min_mm)
    extents_true_mm = np.subtract(truth.extents_max_mm, truth.extents_min_mm)
    extents_error = extents_mm / extents_true_mm - 1.0
    try:
        voxels, hull = compare_voxels(solid.voxels, solid.hull, true_solid)
    except ValueError as error:
        raise UserError(f"{mesh_path}: {error}; repeat the simulation") from None
    skeleton = mesh_path.parent / "skeleton.rsml"
    true_roots = read_rsml(skeleton) if skeleton.is_file() else ()
    both = found.roots and true_roots
    return Score(
        **volume_fields(found, truth.volume_mm3),
        voxel_mm=solid.voxel_mm,
        extents_mm=triple(extents_mm),
        extents_true_mm=triple(extents_true_mm),
        extents_error=triple(extents_error),
        extents_error_max=float(np.abs(extents_error).max()),
        voxels=voxels,
        surface=compare_surfaces(solid.surface, true_solid),
        poses=compare_poses(found.cameras, truth, dataset.scene.camera, centre_mm=np.add(truth.extents_min_mm, truth.extents_max_mm) / 2.0),
        rig=compare_rig(found.rig, found.cameras, truth),
        masks=compare_masks(found.silhouettes, mesh_path.parent / "masks", image_wh=dataset.scene.camera.image_wh),
        hull=hull,
        roots=compare_roots(found.roots, true_roots) if both else None,
        topology=compare_topology(found.roots, true_roots) if both else None,
        plants=compare_plants(found.plants, found.roots, truth.plants, true_roots) if both else (),
        shoot=compare_shoot(found.shoot, truth.shoot, mesh_path.parent),
        traits=compare_traits(found.measured, _true_traits(true_roots, true_solid, truth.volume_mm3)),
        blind_mm3=solid.blind_mm3,
        timings_s=found.timings_s,
        peak_memory_mib=found.peak_memory_mib or None,
        warnings=found.warnings,
    )


def _true_traits(roots: Sequence[Root], solid: Mesh, volume_mm3: float) -> Traits:
    """Measure the traits of the ground truth.

    They are measured anew, because the definitions may have changed since the dataset was simulated.
    """
    return measure_traits(roots, solid.vertices_mm, volume_mm3=volume_mm3, surface_mm2=float(solid.areas_mm2.sum()))
