"""Measurement of random scans, to find out how often 90 % intervals contain the truth.

Each scan is rendered, reconstructed and scored in processes of its own. Measurements with the same code are reused, so
that a stopped run continues.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from benchmarks import cache, datasets, worker
from benchmarks.cases import DEFAULT_VOXEL_MM
from benchmarks.output import VERSIONED
from benchmarks.random_scans import RandomScan
from rhizotwin.scenes import atomic
from rhizotwin.scenes.provenance import versions
from rhizotwin.stored import sources

COUNT = 300

Record = dict[str, Any]


def measure(numbers: Sequence[int], *, processes: int, device: str, say: Callable[[str], None]) -> list[Record]:
    """Render, reconstruct and score random scans.

    Parameters
    ----------
    numbers : sequence of int
        Numbers of the scans, from which each is drawn.
    processes : int
        Number of scans that are processed at the same time.
    device : str
        Computing device.
    say : callable
        Receives the result of every scan.

    Returns
    -------
    list of dict
        One record per scan, in the order of the numbers. The record of a failed scan has ``crashed`` with the error
        instead of ``score`` and ``summary``.
    """
    done = 0

    def one(number: int) -> Record:
        nonlocal done
        record = _measure_one(RandomScan(number=number), device)
        done += 1
        say(f"[{done}/{len(numbers)}] {line(record)}")
        return record

    with ThreadPoolExecutor(max_workers=processes) as pool:
        return list(pool.map(one, numbers))


def _measure_one(scan: RandomScan, device: str) -> Record:
    settings = {"dataset": datasets.place(scan).name, "device": device, "versions": versions(VERSIONED)}
    code = sources.digest(("rhizotwin.recon.reconstruct", "rhizotwin.scoring.score"))
    kept = cache.folder() / "intervals" / f"{cache.key(settings, sources=code)}.json"
    if kept.is_file():
        return dict(json.loads(kept.read_text(encoding="utf-8")))
    record: Record = {
        "number": scan.number,
        "profile": scan.profile,
        "family": scan.family,
        "troubles": scan.troubles(),
        "image_wh": scan.image_wh,
        "views": [ring.views for ring in scan.rings()],
    }
    try:
        if not datasets.is_ready(scan):
            worker.start(["dataset", json.dumps({"random_scan": scan.number})], device=device)
        dataset = str(datasets.place(scan))
        with tempfile.TemporaryDirectory(prefix="rhizotwin-scan-") as folder:
            cost = worker.start(["reconstruct", dataset, folder, "coverage", f"{DEFAULT_VOXEL_MM}", "none"], device=device)
            found = worker.start(["score", f"{folder}/result", dataset, "none"], device=device)
    except RuntimeError as error:
        return record | {"crashed": str(error)}
    record |= {key: found[key] for key in ("score", "summary", "derived")} | {"cpu_s": cost["cpu_s"]}
    atomic.write_json(kept, record)
    return record


def line(record: Record) -> str:
    """Return one line about a scan."""
    width, height = record["image_wh"]
    views = "+".join(str(count) for count in record["views"])
    head = f"{record['number']} {record['family']}/{record['profile']}/{views}x{width}x{height}"
    if "crashed" in record:
        return f"{head}: FAILED\n{record['crashed']}"
    score = record["score"]
    trusted = "reliable" if score["volume_trusted"] else "not reliable"
    holds = "holds" if score["interval_holds_truth"] else "misses"
    return f"{head}: volume {100.0 * score['volume_error']:+.1f} %, interval {holds}, {trusted}"
