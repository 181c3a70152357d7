"""Cache of reconstructions: one folder per key, which contains everything that determines the result.

A reconstruction depends on the pictures and on the code of the method, but not on the code of its score, so that a
change of the score measures nothing again.

    FOLDER/  result/    written by `Result.save`
             stages/    results of the stages (`recon.stages`), if they were kept
             cost.json  times and memory; written last
"""

import json
import shutil
from pathlib import Path
from typing import Any

from benchmarks import cache, datasets, worker
from benchmarks.cases import DEFAULT_VOXEL_MM, Case, Method, Pictures
from rhizotwin.scenes.provenance import versions
from rhizotwin.stored import sources

UNCHANGED = "none"
"""Change of the pictures: none. See `benchmarks.perturb` for the others."""
_SOURCES = {"coverage": ("rhizotwin.recon.reconstruct",), "thesis": ("rhizotwin.scoring.baselines",)}
"""Modules that determine the result for a dataset, by method."""
_VERSIONED = ("mitsuba", "drjit", "numpy", "scipy", "scikit-image", "opencv-python-headless", "trimesh", "manifold3d")


def place(
    pictures: Pictures,
    *,
    device: str,
    method: Method = "coverage",
    voxel_mm: float = DEFAULT_VOXEL_MM,
    change: str = UNCHANGED,
) -> Path:
    """Return the path of a reconstruction in the cache, whether it exists or not.

    Parameters
    ----------
    pictures : Pictures
        Dataset to reconstruct.
    device : str
        Computing device.
    method : Method
        Ours, or that of the thesis.
    voxel_mm : float
        Edge of the voxels, mm.
    change : str
        Change of the pictures: ``none``, ``rounded:SEED`` or ``lossy:SEED`` (`benchmarks.perturb`).
    """
    settings = {
        "dataset": datasets.place(pictures).name,
        "method": method,
        "voxel_mm": voxel_mm,
        "device": device,
        "change": change,
        "versions": versions(_VERSIONED),
    }
    entries = _SOURCES[method] if change == UNCHANGED else (*_SOURCES[method], "benchmarks.perturb")
    code = (sources.digest_of_results if method == "coverage" else sources.digest)(entries)
    return cache.folder() / "reconstructions" / cache.key(settings, sources=code)


def read_cost(folder: Path) -> dict[str, Any] | None:
    """Return times and memory of a complete reconstruction; None if the folder contains none."""
    try:
        return dict(json.loads((folder / "cost.json").read_text(encoding="utf-8")))
    except (OSError, ValueError):
        return None


def render(pictures: Pictures, *, device: str) -> Path:
    """Return the folder of a dataset; it is rendered, or its truth renewed, in a process of its own if necessary."""
    if not datasets.is_ready(pictures):
        worker.start(["dataset", worker.pictures_as_text(pictures)], device=device)
    return datasets.place(pictures)


def make(case: Case, *, device: str, change: str = UNCHANGED, afresh: bool = False, stages: bool = False) -> Path:
    """Return the folder of a case's reconstruction; what is missing is rendered and reconstructed.

    Parameters
    ----------
    case : Case
        Pictures, method and voxel.
    device : str
        Computing device.
    change : str
        Change of the pictures, see `place`.
    afresh : bool
        Whether to repeat an earlier reconstruction.
    stages : bool
        Whether the results of the stages are needed, too.

    Raises
    ------
    RuntimeError
        If rendering or reconstruction failed, with the end of the output.
    """
    folder = place(case.pictures, device=device, method=case.method, voxel_mm=case.voxel_mm, change=change)
    if not afresh and read_cost(folder) is not None and ((folder / "stages").is_dir() or not stages):
        return folder
    dataset_folder = render(case.pictures, device=device)
    shutil.rmtree(folder, ignore_errors=True)
    kept = ["--stages"] if stages else []
    worker.start(["reconstruct", str(dataset_folder), str(folder), case.method, f"{case.voxel_mm}", change, *kept], device=device)
    return folder
