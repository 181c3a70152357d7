"""Jobs from the arguments of a command: datasets, identified by their hashes, and scenes."""

import hashlib
import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rhizotwin import sources
from rhizotwin.batches import places
from rhizotwin.batches.jobs import Job, key_of, named
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.files import scene_to_dict
from rhizotwin.scenes.model import Scene

_PIXELS = 20e6
"""Assumed for a dataset whose manifest cannot be read; its job will fail."""


def reconstructions(scans: Sequence[str], results: str, *, voxel_mm: float | None, settings: Path | None, device: str) -> list[Job]:
    """Return one job for each dataset.

    Parameters
    ----------
    scans : sequence of str
        Datasets, folders that contain datasets, patterns, or addresses.
    results : str
        Folder or address of the results.

    Raises
    ------
    UserError
        If no dataset is found, two would have the same name, or the settings cannot be read.
    """
    found = list(dict.fromkeys(_resolved(dataset) for scan in scans for dataset in places.find_datasets(scan)))
    options: dict[str, Any] = {"voxel_mm": voxel_mm, "settings": None if settings is None else _checked(settings), "device": device}
    code = sources.digest(("rhizotwin.recon.reconstruct",))
    jobs = []
    for name, dataset in zip(named(found), found, strict=True):
        data = _head(dataset)
        decides = {key: value for key, value in options.items() if key != "device"} | {"dataset": hashlib.sha256(data).hexdigest()}
        key, output = key_of(decides, code=code), places.join(results, name)
        jobs.append(Job(name=name, kind="reconstruct", source=dataset, output=output, key=key, pixels=_pixels(data), options=options))
    return jobs


def renderings(scenes: Mapping[str, Scene], datasets: str, *, profile: str, seed: int, device: str) -> list[Job]:
    """Return one job for each scene; the datasets are named like the scenes.

    Parameters
    ----------
    scenes : dict of Scene
        Scenes by name.
    datasets : str
        Folder or address of the datasets.
    profile, seed : str, int
        As `rhizotwin.front_door.simulate`.
    device : str
        Device for the computation.

    Returns
    -------
    list of Job
        One for each scene.
    """
    code = sources.digest(("rhizotwin.sim.simulate",))
    options: dict[str, Any] = {"profile": profile, "seed": seed, "device": device}
    jobs = []
    for name, scene in scenes.items():
        plain = scene_to_dict(scene)
        key = key_of({"scene": plain, "profile": profile, "seed": seed}, code=code)
        width, height = scene.camera.image_wh
        pixels = float(width * height * sum(ring.views for ring in scene.plan.rings))
        text, output = json.dumps(plain), places.join(datasets, name)
        jobs.append(Job(name=name, kind="simulate", source=text, output=output, key=key, pixels=pixels, options=options))
    return jobs


def _resolved(dataset: str) -> str:
    return dataset if places.is_address(dataset) else os.path.realpath(dataset)


def _head(dataset: str) -> bytes:
    """Return the manifest of a dataset; empty if it is a link or cannot be read, so that only this job fails."""
    head = places.join(dataset, places.HEAD)
    try:
        return b"" if Path(head).is_symlink() else places.read(head) or b""
    except UserError:
        return b""


def _checked(settings: Path) -> str:
    """Return the text of a settings file, after validation."""
    from rhizotwin.recon.settings import load_settings

    load_settings(settings)
    return settings.read_text(encoding="utf-8")


def _pixels(data: bytes) -> float:
    """Return the number of pixels of all pictures in a manifest."""
    try:
        manifest = json.loads(data)
        width, height = manifest["scene"]["camera"]["image_wh"]
        return float(width) * float(height) * len(manifest["frames"])
    except (ValueError, KeyError, TypeError, RecursionError):
        return _PIXELS
