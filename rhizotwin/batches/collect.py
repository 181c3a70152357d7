"""Creation of jobs from datasets or scenes given on the command line."""

import hashlib
import json
import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rhizotwin.batches import places
from rhizotwin.batches.jobs import Job, key_of, named
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.files import scene_to_dict
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.plan import count_pictures
from rhizotwin.scenes.reading import read_text
from rhizotwin.stored import sources

_PIXELS = 20e6
"""Number of pixels that is assumed if the file dataset.json of a dataset cannot be read. The error is reported later,
when the job of this dataset is run."""


def reconstructions(scans: Sequence[str], results: str, *, voxel_mm: float | None, settings: Path | None, device: str) -> list[Job]:
    """Create a reconstruction job for each dataset.

    Parameters
    ----------
    scans : sequence of str
        Datasets, folders of datasets, patterns, or addresses.
    results : str
        Folder or address for the results.
    voxel_mm : float or None
        Edge length of the smallest voxels; None: as in the settings.
    settings : Path or None
        Settings file (TOML); None: default settings.
    device : str
        Device for the computation.

    Returns
    -------
    list of Job
        One job per dataset.

    Raises
    ------
    UserError
        If no dataset is found, two results would have the same name, or the settings are invalid.
    """
    found = list(dict.fromkeys(_resolved(dataset) for scan in scans for dataset in places.find_datasets(scan)))
    options: dict[str, Any] = {"voxel_mm": voxel_mm, "settings": None if settings is None else _checked(settings), "device": device}
    code = sources.digest_of_results(("rhizotwin.recon.reconstruct",))
    jobs = []
    for name, dataset in zip(named(found), found, strict=True):
        data = _head(dataset)
        decides = {key: value for key, value in options.items() if key != "device"} | {"dataset": hashlib.sha256(data).hexdigest()}
        key = key_of(decides, code=code)
        output = places.join(results, name)
        jobs.append(Job(name=name, kind="reconstruct", source=dataset, output=output, key=key, pixels=_pixels(data), options=options))
    return jobs


def renderings(scenes: Mapping[str, Scene], datasets: str, *, profile: str, seed: int, device: str) -> list[Job]:
    """Create a rendering job for each scene.

    The dataset has the name of the scene.

    Parameters
    ----------
    scenes : dict of Scene
        Scenes by name.
    datasets : str
        Folder or address for the datasets.
    profile, seed : str, int
        Profile of simulated imperfections, and random seed, see `rhizotwin.steps.front_door.simulate`.
    device : str
        Device for the computation.

    Returns
    -------
    list of Job
        One job per scene.
    """
    code = sources.digest(("rhizotwin.sim.simulate",))
    options: dict[str, Any] = {"profile": profile, "seed": seed, "device": device}
    jobs = []
    for name, scene in scenes.items():
        plain = scene_to_dict(scene)
        key = key_of({"scene": plain, "profile": profile, "seed": seed, "specimens": sources.specimen_hashes(scene)}, code=code)
        width, height = scene.camera.image_wh
        pixels = float(width * height * count_pictures(scene))
        text = json.dumps(plain)
        output = places.join(datasets, name)
        jobs.append(Job(name=name, kind="simulate", source=text, output=output, key=key, pixels=pixels, options=options))
    return jobs


def _resolved(dataset: str) -> str:
    return dataset if places.is_address(dataset) else os.path.realpath(dataset)


def _head(dataset: str) -> bytes:
    """Return the content of dataset.json, or b"" if the file is a link or cannot be read.

    No error is raised here, so that only the job of this dataset fails later, and not the entire batch.
    """
    head = places.join(dataset, places.HEAD)
    try:
        return b"" if Path(head).is_symlink() else places.read(head) or b""
    except (UserError, OSError):  # file systems at addresses raise OSError
        return b""


def _checked(settings: Path) -> str:
    """Validate a settings file, and return its text."""
    from rhizotwin.steps.command_steps import settings_of

    settings_of(settings)
    return read_text(settings)


def _pixels(data: bytes) -> float:
    """Return the total number of pixels of all pictures that dataset.json lists."""
    try:
        manifest = json.loads(data)
        width, height = manifest["scene"]["camera"]["image_wh"]
        pixels = float(width) * float(height) * len(manifest["frames"])
    except (ValueError, KeyError, TypeError, OverflowError, RecursionError):
        return _PIXELS
    return pixels if 0.0 < pixels < math.inf else _PIXELS
