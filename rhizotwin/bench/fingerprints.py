"""Fingerprints of rendered pictures, which verify that two computers have rendered the same data.

Checksums of files would differ because of rounding errors. Instead, pixels at fixed pseudo-random positions are
compared within a tolerance. A difference in 1 % of the pixels is detected with a probability of 0.98 for 24 pictures,
and of 0.999997 for 80 pictures.
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
"""Number of sampled pixels per picture."""
LIMIT = 1e-3
"""Maximum difference between a sampled pixel and its reference, relative to full scale."""
_SAME_VOLUME = 1e-6
"""Maximum relative difference between the true volume and its reference. It allows for rounding differences between
mesh libraries."""


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """Result of comparing a rendered case with its reference fingerprint."""

    case: str
    largest: float
    """Largest difference of a sampled pixel, relative to full scale. It is infinite if there is no reference, or if the
    reference has another number of pictures."""
    volume: float
    """Relative difference between the true volume and its reference. It is infinite if there is no reference."""
    has_reference: bool = True
    """Whether this version of the program has a reference for the case."""

    @property
    def same(self) -> bool:
        """Whether sampled pixels and true volume agree with the reference within the tolerances."""
        return self.largest <= LIMIT and self.volume <= _SAME_VOLUME


def take(folder: Path) -> dict[str, Any]:
    """Return the fingerprint of a rendered case as JSON values.

    It consists of the grey levels (16 bits) of sampled pixels, and of the true volume.
    """
    dataset = load_dataset(folder)
    return {"volume_mm3": load_truth(folder).volume_mm3, "pixels": [_sampled(dataset, k).tolist() for k in range(len(dataset.frames))]}


def compare(folder: Path, case: str, reference: dict[str, Any]) -> Comparison:
    """Compare a rendered case with its reference fingerprint."""
    known = reference.get(case)
    found = take(folder)
    if known is None:
        return Comparison(case=case, largest=float("inf"), volume=float("inf"), has_reference=False)
    largest = float("inf")
    if len(known["pixels"]) == len(found["pixels"]):
        largest = float(np.abs(np.asarray(known["pixels"], np.float64) - np.asarray(found["pixels"], np.float64)).max()) / 65535.0
    return Comparison(case=case, largest=largest, volume=abs(found["volume_mm3"] / known["volume_mm3"] - 1.0))


def write(benchmark: Benchmark, folder: Path, goal: Path) -> None:
    """Write the fingerprints of all cases of a rendered benchmark to a file, which `reference` reads."""
    described = {"benchmark": benchmark.name, "versions": versions(("rhizotwin", "mitsuba", "drjit"))}
    cases = {case.name: take(folder / case.name) for case in benchmark.cases}
    atomic.write_text(goal / f"{benchmark.name}.json", json.dumps({**described, "cases": cases}, separators=(",", ":")) + "\n")


def reference(benchmark: Benchmark) -> dict[str, Any]:
    """Return the reference fingerprints of a benchmark, keyed by the name of the case.

    The result is empty if the program contains no reference for this benchmark.
    """
    file = resources.files("rhizotwin.bench").joinpath("data", f"{benchmark.name}.json")
    return dict(json.loads(file.read_text(encoding="utf-8"))["cases"]) if benchmark.name in BENCHMARKS and file.is_file() else {}


def _sampled(dataset: Dataset, number: int) -> NDArray[np.int64]:
    picture = np.asarray(read_image(dataset, dataset.frames[number]))
    grey = picture.astype(np.float64) * (65535.0 / np.iinfo(picture.dtype).max)
    seed = int.from_bytes(hashlib.sha256(dataset.frames[number].file.encode()).digest()[:8], "big")
    places = np.random.default_rng(seed).integers(0, picture.size, PIXELS)
    return np.round(grey.ravel()[places]).astype(np.int64)
