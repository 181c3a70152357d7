"""Load a result folder as a `Result`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

import numpy as np
import trimesh

from rhizotwin.recon.calibration.cameras import Camera
from rhizotwin.recon.coverage.silhouettes import Silhouette
from rhizotwin.recon.optics.cameras import STILL
from rhizotwin.recon.passes import Pass
from rhizotwin.recon.results import by_plant
from rhizotwin.recon.results.parts import Json, picture_path
from rhizotwin.recon.results.result import POSES, Result, Solid, triple
from rhizotwin.recon.shoots.shoot import Shoot
from rhizotwin.recon.uncertainty.budget import Term, Volume
from rhizotwin.recon.uncertainty.calibration import Calibration
from rhizotwin.recon.uncertainty.checks import Check, Estimate
from rhizotwin.scenes import solution, subject, trait_table
from rhizotwin.stored import result_files


def load_result(folder: Path | str) -> Result:
    """Load a result folder. The silhouettes are read on first use.

    Raises
    ------
    UserError
        If a file is missing or damaged.
    """
    folder = Path(folder)
    summary = result_files.read_summary(folder)
    views = summary["views"]
    files = tuple(view["file"] for view in views if view["used"]) if (folder / "silhouettes").is_dir() else ()
    return Result(
        dataset=str(summary.get("dataset", "")),
        dataset_sha256=summary["dataset_sha256"],
        scene=summary["scene"],
        subject=subject.from_summary(summary, str(folder / "result.json")),
        solution=solution.from_summary(summary, str(folder / "result.json")),
        plants=by_plant.from_summary(summary, str(folder / "result.json")),
        strip=result_files.read_strip(folder, summary),
        solid=_solid(folder, summary),
        mass_g=summary.get("mass_g"),
        cameras=tuple(_camera(view) for view in views),
        shoot=_shoot(folder, summary.get("shoot")),
        edits=summary.get("edits"),
        bands=summary.get("bands") or {},
        fill={view["file"]: view["fill"] for view in views if view.get("fill") is not None},
        rig=summary.get("rig") or {},
        warnings=tuple(summary["warnings"]),
        checks=tuple(Check(**check) for check in summary.get("checks", ())),
        estimates=tuple(Estimate(**{**one, "interval": tuple(one["interval"])}) for one in summary.get("estimates", ())),
        timings_s={str(stage): float(seconds) for stage, seconds in summary["timings_s"].items()},
        passes={kind: int(summary[kind]) for kind in get_args(Pass) if kind in summary},
        peak_memory_mib=float(summary.get("peak_memory_mib") or 0.0),
        settings=summary.get("settings", {}),
        versions=summary.get("versions", {}),
        silhouettes=_Stored(folder, files),
    )


def _solid(folder: Path, summary: Json) -> Solid:
    """Read the reconstructed shape."""
    mesh = result_files.read_mesh(folder / "shape.ply")
    low, high = summary["volume_interval_mm3"]
    least, most = summary["volume_bounds_mm3"]
    return Solid(
        voxels=result_files.read_leaves(folder),
        hull=result_files.read_leaves(folder, hull=True),
        finest_mm=result_files.finest_mm(summary),
        mesh=trimesh.Trimesh(mesh.vertices_mm, mesh.faces, process=False),
        volume=Volume(
            mm3=float(summary["volume_mm3"]),
            interval_mm3=(float(low), float(high)),
            bounds_mm3=(float(least), float(most)),
            trusted=summary["volume_trusted"],
            verdict=summary["volume_verdict"],
            terms=tuple(_term(term) for term in summary["volume_budget"]),
            calibration=Calibration.from_plain(summary.get("calibration")),
        ),
        hull_mm3=float(summary["hull_mm3"]),
        untrimmed_mm3=float(summary["untrimmed_mm3"]),
        blind_mm3=float(summary["blind_mm3"]),
        hidden_height_mm=float(summary.get("hidden_height_mm", 0.0)),
        extents_min_mm=tuple(summary["extents_min_mm"]),
        extents_max_mm=tuple(summary["extents_max_mm"]),
        mu_per_mm=summary.get("root_mu_per_mm"),
        mu_sigma_per_mm=summary.get("root_mu_sigma_per_mm"),
        roots=result_files.read_roots(folder),
    )


def _shoot(folder: Path, summary: Json | None) -> Shoot | None:
    """Read the shoot. Return None if the result has no shoot."""
    if summary is None:
        return None
    mesh = result_files.read_mesh(folder / "shoot.ply")
    return Shoot(
        mesh=trimesh.Trimesh(mesh.vertices_mm, mesh.faces, process=False),
        hull_mm3=float(summary["hull_mm3"]),
        blades_mm2=tuple(float(area) for area in summary.get("blades_mm2", ())),
        leaf_area_mm2=summary.get("leaf_area_mm2", 0.5 * float(mesh.areas_mm2.sum())),
        stalks_mm3=float(summary.get("stalks_mm3", 0.0)),
        leaf_thickness_mm=summary.get("leaf_thickness_mm"),
        pot_top_mm=float(summary["pot_top_mm"]),
        covered_px={str(file): float(pixels) for file, pixels in summary["covered_px"].items()},
        mm2_per_px={str(file): float(area) for file, area in summary["mm2_per_px"].items()},
        hidden_share=float(summary["hidden_share"]),
        enclosed_share=float(summary.get("enclosed_share", 0.0)),
        colour={name: float(summary[name]) for name in trait_table.COLOURS if name in summary},
        leaf_colours=tuple({name: float(value) for name, value in one.items()} for one in summary.get("leaf_colours", ())),
    )


def _camera(view: Json) -> Camera:
    """Convert a view of ``result.json`` to a camera."""
    given = (view.get(name) for name in POSES)
    pose, tank = (None if matrix is None else np.array(matrix, np.float64) for matrix in given)
    return Camera(
        file=view["file"],
        ring=view.get("ring", 0),
        used=view["used"],
        reason=view.get("reason"),
        cam_from_canister=pose,
        cam_from_tank=tank,
        sway=triple(np.array(view.get("sway", STILL), np.float64)),
        reprojection_px=view.get("reprojection_px"),
        markers=view.get("markers", 0),
        table_deg=view.get("table_deg"),
        position_sigma_mm=view.get("position_sigma_mm"),
        rotation_sigma_deg=view.get("rotation_sigma_deg"),
        sha256=str(view.get("sha256") or ""),
    )


def _term(term: Json) -> Term:
    """Convert a cause of uncertainty of ``result.json`` to a `Term`."""
    return Term(name=term.get("name", ""), less_mm3=term["less_mm3"], more_mm3=term["more_mm3"], why=term["why"])


def read_silhouette(folder: Path, file: str) -> Silhouette:
    """Read the silhouette of a picture from a result folder.

    All pixels are usable if the folder contains no mask of the usable pixels.

    Raises
    ------
    UserError
        If the silhouette is missing or damaged.
    """
    coverage = result_files.read_grey(picture_path(folder / "silhouettes", file))
    seen = picture_path(folder / "seen", file)
    known = result_files.read_grey(seen, image_wh=coverage.shape[::-1]) > 0.5 if seen.is_file() else np.ones(coverage.shape, bool)
    return Silhouette(coverage, known)


@dataclass(frozen=True)
class _Stored(Mapping[str, Silhouette]):
    """Silhouettes in a result folder, keyed by file name of the picture.

    A silhouette is read from its file on access.
    """

    folder: Path
    """Result folder."""
    files: tuple[str, ...]
    """File names of the pictures with silhouettes."""

    def __getitem__(self, file: str) -> Silhouette:
        if file not in self.files:
            raise KeyError(file)
        return read_silhouette(self.folder, file)

    def __iter__(self) -> Iterator[str]:
        return iter(self.files)

    def __len__(self) -> int:
        return len(self.files)
