"""The accuracy ladder: render (or take from the cache), reconstruct, score."""

import shutil
import tempfile
import time
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from benchmarks import cache, projection
from benchmarks.cases import Case, Pictures
from benchmarks.metric import Metric
from benchmarks.thesis import reconstruct_thesis
from recon.pipeline import reconstruct
from recon.score import Score, score
from scenes.files import scene_to_dict
from sim.simulate import simulate

Say = Callable[[str], None]


@dataclass
class Run:
    """What a benchmark run measured."""

    metrics: list[Metric] = field(default_factory=list)
    crashed: dict[str, str] = field(default_factory=dict)
    """Traceback by case."""
    details: dict[str, Any] = field(default_factory=dict)
    """Everything else worth keeping, by case."""


def dataset_settings(pictures: Pictures) -> dict[str, Any]:
    """Return all that decides what a dataset looks like, besides the sources, as JSON values."""
    import mitsuba as mi

    return {
        "scene": scene_to_dict(pictures.scene_to_render()),
        "profile": pictures.profile,
        "seed": pictures.seed,
        "fidelity": "backlit",
        "mitsuba": mi.__version__,
    }


def dataset(pictures: Pictures, *, sources: str) -> Path:
    """Return the folder of a rendered dataset, rendering it where the cache lacks it (and resuming where it was cut off)."""
    folder = cache.folder() / "datasets" / cache.key(dataset_settings(pictures), sources=sources)
    if folder.is_dir():
        return folder
    unfinished = folder.with_suffix(".part")
    simulate(pictures.scene_to_render(), unfinished, profile_name=pictures.profile, seed=pictures.seed, fidelity="backlit", progress=False)
    unfinished.rename(folder)
    return folder


def measure(cases: Sequence[Case], *, say: Say) -> Run:
    """Run the cases one after the other; a case that fails is recorded and the rest go on."""
    run = Run(metrics=projection.measure())
    sources = cache.source_digest()
    for number, case in enumerate(cases, start=1):
        began = time.perf_counter()
        try:
            folder = dataset(case.pictures, sources=sources)
            rendered = time.perf_counter()
            found = reconstruct_and_score(case, folder)
        except Exception:  # noqa: BLE001 - whatever it is, the gate must hear of it
            run.crashed[case.name] = traceback.format_exc()
            say(f"[{number}/{len(cases)}] {case.name}: CRASHED\n{run.crashed[case.name]}")
            continue
        run.metrics += metrics(case.name, found)
        run.details[case.name] = {
            **found.to_dict(),
            "render_s": rendered - began,
            "reconstruct_and_score_s": time.perf_counter() - rendered,
        }
        say(
            f"[{number}/{len(cases)}] {case.name}: volume {100.0 * found.volume_error:+.2f} %, "
            f"IoU {found.voxels.iou:.3f} ({time.perf_counter() - began:.0f} s)"
        )
    return run


def reconstruct_and_score(case: Case, dataset_folder: Path) -> Score:
    """Reconstruct into a temporary folder and return the score."""
    working = Path(tempfile.mkdtemp(prefix="rhizotwin-benchmark-"))
    try:
        if case.method == "thesis":
            reconstruct_thesis(dataset_folder, working / "result", voxel_mm=case.voxel_mm)
        else:
            reconstruct(dataset_folder, working / "result", voxel_mm=case.voxel_mm, progress=False)
        return score(working / "result", dataset_folder)
    finally:
        shutil.rmtree(working, ignore_errors=True)


def metrics(case_name: str, found: Score) -> list[Metric]:
    """Return the gated numbers of one score; a stage that gave none yields NaN, which fails the gate."""
    missing = float("nan")
    poses, masks = found.poses, found.masks
    # (name, value, unit, direction, rel_tol, abs_tol): the arithmetic repeats to about 1e-5 on one machine, and other machines'
    # vector units move thresholds a little; a real change of method moves these numbers by far more.
    rows: list[tuple[str, float, str, Any, float, float]] = [
        ("volume_error", found.volume_error, "1", "zero", 0.0, 0.002),
        ("extents_error_max", found.extents_error_max, "1", "down", 0.0, 0.002),
        ("recall", found.voxels.recall, "1", "up", 0.0, 0.004),
        ("precision", found.voxels.precision, "1", "up", 0.0, 0.004),
        ("iou", found.voxels.iou, "1", "up", 0.0, 0.004),
        ("surface_median_mm", found.surface.median_mm, "mm", "down", 0.05, 0.002),
        ("surface_p95_mm", found.surface.p95_mm, "mm", "down", 0.1, 0.01),
        ("views_used", float(poses.used) if poses else missing, "1", "up", 0.0, 0.0),
        ("pose_median_mm", poses.median_mm if poses else missing, "mm", "down", 0.1, 0.002),
        ("pose_median_deg", poses.median_deg if poses else missing, "deg", "down", 0.1, 0.0005),
        ("mask_area_error", masks.area_error if masks else missing, "1", "zero", 0.0, 0.003),
        ("mask_iou", masks.iou if masks else missing, "1", "up", 0.0, 0.004),
        ("hull_recall", found.hull.recall, "1", "up", 0.0, 0.004),
        ("hull_volume_error", found.hull.volume_error, "1", "zero", 0.0, 0.004),
    ]
    return [
        Metric(key=f"{case_name}/{name}", value=value, unit=unit, direction=direction, rel_tol=rel_tol, abs_tol=abs_tol)
        for name, value, unit, direction, rel_tol, abs_tol in rows
    ]
