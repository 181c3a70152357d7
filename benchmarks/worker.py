"""One job of the benchmarks in its own process, so that its memory can be measured.

The last line of output is its numbers as JSON.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

from benchmarks.cases import METHODS, Pictures
from benchmarks.random_scans import RandomScan

ROOT = Path(__file__).resolve().parent.parent
LAST_WORDS = 4000
"""Length of a failed job's error text that is reported."""
LONG = ("views", "rig", "settings", "versions")
"""Entries of a result's summary that are not reported."""


def start(arguments: Sequence[str], *, device: str) -> dict[str, Any]:
    """Run one job in a new process.

    Return its numbers and the wall time ``wall`` of the process (including start and imports).

    Raises
    ------
    RuntimeError
        If the job failed, with the end of its output.
    """
    with tempfile.TemporaryDirectory(prefix="rhizotwin-benchmark-") as working:
        began = time.perf_counter()
        done = subprocess.run(
            [sys.executable, "-m", "benchmarks.worker", "--device", device, "--working", working, *arguments],
            cwd=ROOT,
            capture_output=True,
            text=True,
            check=False,
        )
        wall = time.perf_counter() - began
    if done.returncode != 0:
        raise RuntimeError(f"`{' '.join(arguments)}` ended with code {done.returncode}\n{done.stderr[-LAST_WORDS:]}")
    found: dict[str, Any] = json.loads(done.stdout.strip().splitlines()[-1])
    return {"wall": wall, **found}


def pictures_as_text(pictures: Pictures) -> str:
    """Return pictures as one argument of a job."""
    return json.dumps(asdict(pictures))


def parse_pictures(text: str) -> Pictures | RandomScan:
    """Return the pictures described by an argument."""
    plain = json.loads(text)
    if "random_scan" in plain:
        return RandomScan(number=plain["random_scan"])
    return Pictures(**{**plain, "image_wh": tuple(plain["image_wh"])})


def dataset(pictures: Pictures | RandomScan) -> dict[str, Any]:
    """Add a dataset to the cache."""
    from benchmarks import datasets

    return {"folder": str(datasets.make(pictures))}


def reconstruct(given: argparse.Namespace) -> dict[str, Any]:
    """Reconstruct a dataset by a method into a folder (`benchmarks.reconstructions`).

    A result of changed pictures is saved as that of the original dataset, with whose truth it is compared.

    Parameters
    ----------
    given : argparse.Namespace
        Dataset, goal, method, voxel_mm, change, and whether the stages are kept.

    Returns
    -------
    dict
        Times and memory.
    """
    from benchmarks import commits, perturb
    from rhizotwin.recon.reconstruct import reconstruct
    from rhizotwin.recon.settings import Settings
    from rhizotwin.scenes import atomic, memory
    from rhizotwin.scenes.dataset import load_dataset
    from rhizotwin.scoring.baselines import reconstruct_baseline

    kind, _, seed = given.change.partition(":")
    vectors = perturb.halve_vectors() if kind == "rounded" and int(seed) % 2 else "default vectors"
    original = load_dataset(given.dataset)
    folder = given.dataset
    if kind != "none":
        folder = perturb.WRITERS[kind](given.dataset, given.working / "dataset", seed=int(seed)).folder
    began, busy = time.perf_counter(), time.process_time()
    kept = {"keep_stages": given.goal / "stages"} if given.stages else {}
    find = partial(reconstruct_baseline, method="thesis") if given.method == "thesis" else partial(reconstruct, **kept)
    result = find(folder, settings=Settings(voxel_mm=given.voxel_mm))
    cost = {
        "wall_s": time.perf_counter() - began,
        "cpu_s": time.process_time() - busy,
        "peak_memory_mib": memory.peak_mib(),
        "load": os.getloadavg()[0],
        "vectors": vectors,
        "commit": commits.last_of_reconstruction(),
    }
    replace(result, dataset=str(given.dataset), dataset_sha256=original.sha256).save(given.goal / "result")
    atomic.write_json(given.goal / "cost.json", cost)
    return cost


def score(result_folder: Path, dataset_folder: Path, fault: str) -> dict[str, Any]:
    """Score a result.

    Parameters
    ----------
    result_folder, dataset_folder : Path
        Folders of the result and of its dataset.
    fault : str
        Deliberate fault of the roots (`benchmarks.tree_faults`), or ``none``.

    Returns
    -------
    dict
        Score, a summary of the result, and intervals of the traits in `benchmarks.intervals_table.DERIVED`.
    """
    from benchmarks import intervals_table, tree_faults
    from rhizotwin.scoring import score as scoring
    from rhizotwin.stored.load import load_result
    from rhizotwin.stored.result_files import read_summary

    result = load_result(result_folder)
    if fault != tree_faults.NONE:
        result = replace(result, solid=replace(result.solid, roots=tree_faults.apply(fault, result.solid.roots)))
    found = scoring.score(result, dataset_folder).to_dict()
    if found["masks"]:
        del found["masks"]["per_view"]
    summary = {key: value for key, value in read_summary(result_folder).items() if key not in LONG}
    return {"score": found, "summary": summary, "derived": intervals_table.derived_intervals(result_folder)}


def projection() -> dict[str, Any]:
    """Return the numbers of `benchmarks.projection`."""
    from benchmarks import projection as against_tracing

    return {"metrics": [asdict(metric) for metric in against_tracing.measure()]}


def parser() -> argparse.ArgumentParser:
    """Return the parser of the jobs' command line."""
    made = argparse.ArgumentParser(description=__doc__)
    made.add_argument("--device", default="auto")
    made.add_argument("--working", type=Path, required=True)
    jobs = made.add_subparsers(dest="job", required=True)
    making = jobs.add_parser("dataset")
    making.add_argument("pictures", type=parse_pictures)
    reconstructing = jobs.add_parser("reconstruct")
    reconstructing.add_argument("dataset", type=Path)
    reconstructing.add_argument("goal", type=Path)
    reconstructing.add_argument("method", choices=METHODS)
    reconstructing.add_argument("voxel_mm", type=float)
    reconstructing.add_argument("change")
    reconstructing.add_argument("--stages", action="store_true")
    scoring = jobs.add_parser("score")
    scoring.add_argument("result", type=Path)
    scoring.add_argument("dataset", type=Path)
    scoring.add_argument("fault")
    jobs.add_parser("projection")
    return made


def main() -> int:
    """Run the job given by the arguments."""
    given = parser().parse_args()

    from rhizotwin import engine
    from rhizotwin.scenes import memory

    engine.start(given.device)
    work = {
        "dataset": lambda: dataset(given.pictures),
        "reconstruct": lambda: reconstruct(given),
        "score": lambda: score(given.result, given.dataset, given.fault),
        "projection": projection,
    }
    found = work[given.job]()
    sys.stdout.write("\n" + json.dumps({"peak_memory": memory.peak_mib(), **found}) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
