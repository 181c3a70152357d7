"""A dataset whose job fails at once, and jobs."""

from dataclasses import replace
from pathlib import Path

from rhizotwin.batches.jobs import Job
from rhizotwin.scenes.dataset import Dataset, Frame, save_dataset
from rhizotwin.scenes.model import Scene


def dataset(folder: Path, *, name: str = "scene") -> Path:
    """Write a dataset whose only picture is missing: its job fails at once."""
    save_dataset(Dataset(folder=folder, scene=Scene(name=name), frames=(Frame(file="images/a.png", sha256=""),)))
    return folder


def job(name: str, folder: Path, **changes: object) -> Job:
    options = {"voxel_mm": None, "settings": None, "device": "cpu"}
    plain = Job(name=name, kind="reconstruct", source=str(folder / "none"), output=str(folder / name), key="k", pixels=1e6, options=options)
    return replace(plain, **changes)
