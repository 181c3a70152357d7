"""Time and memory of the jobs, each in its own process."""

import statistics
from typing import Any, get_args

from benchmarks import datasets, worker
from benchmarks.cases import Pictures
from benchmarks.metric import Metric
from benchmarks.run import Run, Say
from rhizotwin.recon.passes import Pass

TIME_TOLERANCE = 0.5
"""Relative tolerance: wall times on a shared machine vary by tens of per cent from run to run."""

RECONSTRUCTED = Pictures(scene="printed_8ml")


def measure(*, quick: bool, device: str, say: Say) -> Run:
    """Time one rendered view and complete reconstructions; a failed job is recorded, and the rest continue.

    Parameters
    ----------
    quick : bool
        Whether to run once, with coarse voxels only.
    device : str
        Computing device.
    say : Say
        Receives the time of every job.

    Returns
    -------
    Run
        Times, memory, and crashed jobs.
    """
    run = Run()
    repeats = 1 if quick else 3
    if not datasets.is_ready(RECONSTRUCTED):
        worker.start(["dataset", worker.pictures_as_text(RECONSTRUCTED)], device=device)
    dataset_folder = datasets.place(RECONSTRUCTED)
    jobs: list[tuple[str, list[str]]] = [("render/backlit/800x600", ["render", "backlit"])]
    if not quick:
        jobs.append(("render/path/800x600", ["render", "path"]))
    for voxel_mm in (0.27,) if quick else (0.27, 0.07):
        jobs.append((f"reconstruct/40x800x600/{voxel_mm:g}", ["stages", str(dataset_folder), str(voxel_mm)]))
    for name, arguments in jobs:
        try:
            repeated = [worker.start(arguments, device=device) for _ in range(repeats)]
        except RuntimeError as error:
            run.crashed[name] = str(error)
            say(f"{name}: CRASHED\n{error}")
            continue
        run.details[name] = repeated
        run.metrics += metrics(name, repeated)
        say(f"{name}: " + ", ".join(f"{m.key.removeprefix(name + '/')} {m.value:.4g} {m.unit}" for m in metrics(name, repeated)))
    return run


def metrics(name: str, repeated: list[dict[str, Any]]) -> list[Metric]:
    """Return the medians over the repeats: times in s by stage, memory in MiB, and numbers of passes."""
    found = []
    for quantity in repeated[0]:
        if quantity == "stages":
            continue
        middle = statistics.median(float(once[quantity]) for once in repeated)
        unit = "MiB" if quantity == "peak_memory" else "1" if quantity in get_args(Pass) else "s"
        found.append(_metric(f"{name}/{quantity}", middle, unit))
    for stage in repeated[0].get("stages", {}):
        found.append(_metric(f"{name}/stage/{stage}", statistics.median(float(once["stages"][stage]) for once in repeated), "s"))
    return found


def _metric(key: str, value: float, unit: str) -> Metric:
    relative, absolute = {"s": (TIME_TOLERANCE, 1.0), "MiB": (0.2, 100.0), "1": (0.1, 2.0)}[unit]
    return Metric(key=key, value=value, unit=unit, direction="down", rel_tol=relative, abs_tol=absolute)
