"""Accuracy ladder: render (or load from the cache), reconstruct and score, each case in its own process."""

import json
import statistics
import time
from collections.abc import Sequence
from math import nan
from pathlib import Path
from typing import Any

from benchmarks import cache, datasets, reconstructions, tree_faults, worker
from benchmarks.cases import NIGHTLY, Case
from benchmarks.metric import Direction, Metric
from benchmarks.output import value_at
from benchmarks.reconstructions import UNCHANGED
from benchmarks.run import Run, Say
from rhizotwin.scenes import atomic
from rhizotwin.stored import sources

Record = dict[str, Any]
"""One scored case as a JSON object: its description, its cost, and the score."""


def measure(
    cases: Sequence[Case],
    *,
    device: str,
    say: Say,
    afresh: bool = False,
    change: str = UNCHANGED,
    fault: str = tree_faults.NONE,
) -> Run:
    """Run the cases in order; a failed case is recorded, and the rest continue.

    Parameters
    ----------
    cases : sequence of Case
        Cases to run.
    device : str
        ``auto``, ``cpu`` or ``cuda``.
    say : Say
        Receives the progress.
    afresh : bool
        Whether to repeat measurements of an earlier run with the same sources, settings and versions.
    change : str
        Change of the pictures: ``none``, ``rounded:SEED`` or ``lossy:SEED`` (`benchmarks.perturb`).
    fault : str
        Deliberate fault of the roots before they are scored: ``none``, or a key of `tree_faults.FAULTS`.

    Returns
    -------
    Run
        Metrics of successful cases, and crashed cases.
    """
    say(f"{len(cases)} cases, with earlier measurements by this code in {cache.folder()}")
    run = Run()
    clock = _TimeLeft(cases)
    for number, case in enumerate(cases, start=1):
        head = f"[{number}/{len(cases)}] {case.name}"
        began = time.perf_counter()
        record = None if afresh else load_record(case, device=device, change=change, fault=fault)
        try:
            fresh = record is None
            record = record or compute_record(case, device=device, change=change, fault=fault, afresh=afresh)
        except RuntimeError as error:
            run.crashed[case.name] = str(error)
            clock.finished(case, time.perf_counter() - began)
            say(f"{head}: CRASHED; {clock.left()}\n{error}")
            continue
        run.metrics += metrics(case, record)
        run.details[case.name] = record
        clock.finished(case, time.perf_counter() - began if fresh else None)
        say(f"{head}: {summary(record)}{'' if fresh else ', kept'}; {clock.left()}")
    return run


def projection(device: str) -> list[Metric]:
    """Return the numbers of the projection, which depend on no picture."""
    return [Metric(**metric) for metric in worker.start(["projection"], device=device)["metrics"]]


def load_record(case: Case, *, device: str, change: str = UNCHANGED, fault: str = tree_faults.NONE) -> Record | None:
    """Return the record of a case from an earlier run with the same sources, settings, calibration and versions.

    Return None if there is none.

    Parameters
    ----------
    case : Case
        Pictures, method and voxel.
    device : str
        Computing device.
    change, fault : str
        Change of the pictures and fault of the roots, see `measure`.

    Returns
    -------
    dict or None
        Record of the case; None if there is none.
    """
    try:
        record = json.loads(_kept_path(case, device=device, change=change, fault=fault).read_text(encoding="utf-8"))
    except (OSError, ValueError):  # a damaged file is ignored, and the case measured again
        return None
    return record if isinstance(record, dict) and {"case", "commit", "score", "wall_s", "peak_memory_mib"} <= record.keys() else None


def _kept_path(case: Case, *, device: str, change: str, fault: str) -> Path:
    settings = {"reconstruction": _place(case, device=device, change=change).name, "truth": sources.digest(datasets.TRUTH), "fault": fault}
    faults = () if fault == tree_faults.NONE else ("benchmarks.tree_faults",)
    return cache.folder() / "scores" / f"{cache.key(settings, sources=sources.digest(('rhizotwin.scoring.score', *faults)))}.json"


def _place(case: Case, *, device: str, change: str) -> Path:
    return reconstructions.place(case.pictures, device=device, method=case.method, voxel_mm=case.voxel_mm, change=change)


def compute_record(case: Case, *, device: str, change: str = UNCHANGED, fault: str = tree_faults.NONE, afresh: bool = False) -> Record:
    """Render a case's pictures and reconstruct them, if they are missing, score the result, and cache the score.

    Parameters
    ----------
    case : Case
        Pictures, method and voxel.
    device : str
        Computing device.
    change, fault : str
        Change of the pictures and fault of the roots, see `measure`.
    afresh : bool
        Whether to reconstruct again.

    Returns
    -------
    dict
        Score, times and memory.
    """
    folder = reconstructions.make(case, device=device, change=change, afresh=afresh)
    dataset_folder = reconstructions.render(case.pictures, device=device)
    found = worker.start(["score", str(folder / "result"), str(dataset_folder), fault], device=device)
    record = {"case": describe_case(case), **(reconstructions.read_cost(folder) or {}), **found}
    atomic.write_json(_kept_path(case, device=device, change=change, fault=fault), record)
    return record


def describe_case(case: Case) -> dict[str, Any]:
    """Return the description of a case as a JSON object."""
    pictures = case.pictures
    return {
        "name": case.name,
        "scene": pictures.scene,
        "profile": pictures.profile,
        "seed": pictures.seed,
        "rings": pictures.rings,
        "views": pictures.views,
        "image_wh": list(pictures.image_wh),
        "method": case.method,
        "voxel_mm": case.voxel_mm,
        "is_plant": pictures.is_plant,
        "age_days": getattr(pictures.scene_to_render().specimen, "age_days", None),
    }


def summary(record: Record) -> str:
    """Return one line with the result of a case."""
    found, roots = record["score"], record["score"].get("roots")
    text = f"volume {percent(found['volume_error'])}, interval {'holds' if found['interval_holds_truth'] else 'misses'}"
    if roots:
        text += f", length {percent(roots['length_error'])}, tips {roots['tip_precision']:.2f} / {roots['tip_recall']:.2f}"
        text += f", identity {found['topology']['identity']:.3f}"
    return f"{text}, {record['wall_s']:.0f} s, {record['peak_memory_mib'] / 1024.0:.1f} GiB"


def percent(fraction: float | None) -> str:
    """Return a signed fraction as text."""
    return "none" if fraction is None else f"{100.0 * fraction:+.2f} %"


def metrics(case: Case, record: Record) -> list[Metric]:
    """Return the gated numbers of one score; a missing number becomes NaN, which fails the gate."""
    found = record["score"]
    # (where, unit, direction, rel_tol, abs_tol): tolerances for cases without a measured scatter (`benchmarks.scatter`)
    volume, voxels = (0.005, 0.01) if case.pictures.is_plant else (0.002, 0.004)
    line = 0.02 if case.pictures.scene in NIGHTLY else 0.005  # in dense root systems, rounding decides more of the length
    rows: dict[str, tuple[str, str, Direction, float, float]] = {
        "volume_error": ("volume_error", "1", "zero", 0.0, volume),
        "extents_error_max": ("extents_error_max", "1", "down", 0.0, 0.002),
        "recall": ("recall", "1", "up", 0.0, voxels),
        "precision": ("precision", "1", "up", 0.0, voxels),
        "iou": ("iou", "1", "up", 0.0, voxels),
        "surface_median_mm": ("surface.median_mm", "mm", "down", 0.05, 0.002),
        "surface_p95_mm": ("surface.p95_mm", "mm", "down", 0.1, 0.01),
        "views_used": ("poses.used", "1", "up", 0.0, 0.0),
        "pose_median_mm": ("poses.median_mm", "mm", "down", 0.1, 0.002),
        "pose_median_deg": ("poses.median_deg", "deg", "down", 0.1, 0.0005),
        "mask_area_error": ("masks.area_error", "1", "zero", 0.0, 0.003),
        "mask_iou": ("masks.iou", "1", "up", 0.0, 0.004),
        "hull_recall": ("hull.recall", "1", "up", 0.0, 0.004),
        "hull_volume_error": ("hull.volume_error", "1", "zero", 0.0, 0.004),
    }
    if case.method == "coverage":
        rows["interval_holds"] = ("interval_holds_truth", "1", "up", 0.0, 0.0)
        if case.pictures.has_roots:  # one tip, or one branch point, is a few per cent of a small plant's
            rows |= {
                "length_error": ("roots.length_error", "1", "zero", 0.0, line),
                "line_recall": ("roots.recall", "1", "up", 0.0, line),
                "line_precision": ("roots.precision", "1", "up", 0.0, line),
                "tip_recall": ("roots.tip_recall", "1", "up", 0.0, 0.03),
                "tip_precision": ("roots.tip_precision", "1", "up", 0.0, 0.03),
                "identity": ("topology.identity", "1", "up", 0.0, line),
                "order_length": ("topology.order_length", "1", "up", 0.0, line),
                "main_length": ("topology.main_length", "1", "up", 0.0, 0.01),
                "branch_recall": ("topology.branch_recall", "1", "up", 0.0, 0.03),
                "branch_precision": ("topology.branch_precision", "1", "up", 0.0, 0.03),
                "ghosts_mm": ("topology.ghosts_mm", "mm", "down", 0.1, 2.0),
                "doubled_mm": ("topology.doubled_mm", "mm", "zero", 0.1, 2.0),
                "missing_mm": ("topology.missing_mm", "mm", "down", 0.1, 2.0),
            }
    return [
        Metric(
            key=f"{case.name}/{name}",
            value=nan if (value := value_at(found, where)) is None else value,
            unit=unit,
            direction=direction,
            rel_tol=rel_tol,
            abs_tol=abs_tol,
        )
        for name, (where, unit, direction, rel_tol, abs_tol) in rows.items()
    ]


class _TimeLeft:
    """Estimate of the remaining time, from completed cases of the same method."""

    def __init__(self, cases: Sequence[Case]) -> None:
        self._waiting = list(cases)
        self._seconds: dict[str, list[float]] = {}

    def finished(self, case: Case, seconds: float | None) -> None:
        """Add a completed case; None for one from the cache."""
        self._waiting.remove(case)
        if seconds is not None:
            self._seconds.setdefault(case.method, []).append(seconds)

    def left(self) -> str:
        """Return the remaining time as text."""
        everything = [seconds for measured in self._seconds.values() for seconds in measured]
        if not self._waiting:
            return "done"
        if not everything:
            return f"{len(self._waiting)} left"
        seconds = sum(statistics.mean(self._seconds.get(case.method, everything)) for case in self._waiting)
        return f"about {seconds / 60.0:.0f} min left"
