"""Fingerprints of rendered pictures, for checking that two computers rendered the same data.

Checksums of files would change with rounding errors. Instead, pixels at random positions with a fixed seed are
compared: a difference in 1 % of the pixels of 24 pictures is detected with a probability of 0.98, of 80 pictures with
0.999997.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rhizotwin.bench.benchmarks import BENCHMARKS, Benchmark
from rhizotwin.scenes import atomic
from rhizotwin.scenes.dataset import Dataset, load_dataset, read_image
from rhizotwin.scenes.provenance import versions
from rhizotwin.scenes.truth import load_truth

PIXELS = 16
"""Sampled pixels per picture."""
LIMIT = 1e-3
"""Maximum difference, relative to full scale."""
_SAME_VOLUME = 1e-6
"""Relative tolerance of the volume; versions of the mesh library differ in rounding."""


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """Difference between a rendered case and the reference."""

    case: str
    largest: float
    """Largest difference of sampled pixels relative to full scale; infinite if the pictures cannot be compared."""
    volume: float
    """Relative difference of the true volumes."""

    @property
    def same(self) -> bool:
        """Return whether the case equals the reference up to rounding."""
        return self.largest <= LIMIT and self.volume <= _SAME_VOLUME


def take(folder: Path) -> dict[str, Any]:
    """Compute the fingerprint of a rendered case as JSON values: sampled 16-bit grey levels and the volume."""
    dataset = load_dataset(folder)
    return {"volume_mm3": load_truth(folder).volume_mm3, "pixels": [_sampled(dataset, k).tolist() for k in range(len(dataset.frames))]}


def compare(folder: Path, case: str, reference: dict[str, Any]) -> Comparison:
    """Compare a rendered case with its reference fingerprint."""
    known, found = reference.get(case), take(folder)
    if known is None or len(known["pixels"]) != len(found["pixels"]):
        return Comparison(case=case, largest=float("inf"), volume=float("inf"))
    away = np.abs(np.asarray(known["pixels"], np.float64) - np.asarray(found["pixels"], np.float64)).max()
    return Comparison(case=case, largest=float(away) / 65535.0, volume=abs(found["volume_mm3"] / known["volume_mm3"] - 1.0))


def write(benchmark: Benchmark, folder: Path, goal: Path) -> None:
    """Write the fingerprints of a rendered benchmark to a folder, for `reference`."""
    described = {"benchmark": benchmark.name, "versions": versions(("rhizotwin", "mitsuba", "drjit"))}
    cases = {case.name: take(folder / case.name) for case in benchmark.cases}
    atomic.write_text(goal / f"{benchmark.name}.json", json.dumps({**described, "cases": cases}, separators=(",", ":")) + "\n")


def reference(benchmark: Benchmark) -> dict[str, Any]:
    """Return the reference fingerprints of the cases of a benchmark; empty if there are none."""
    file = resources.files("rhizotwin.bench").joinpath("data", f"{benchmark.name}.json")
    return dict(json.loads(file.read_text(encoding="utf-8"))["cases"]) if benchmark.name in BENCHMARKS and file.is_file() else {}


def _sampled(dataset: Dataset, number: int) -> NDArray[np.int64]:
    picture = np.asarray(read_image(dataset, dataset.frames[number]))
    grey = picture.astype(np.float64) * (65535.0 / np.iinfo(picture.dtype).max)
    seed = int.from_bytes(hashlib.sha256(dataset.frames[number].file.encode()).digest()[:8], "big")
    places = np.random.default_rng(seed).integers(0, picture.size, PIXELS)
    return np.round(grey.ravel()[places]).astype(np.int64)
