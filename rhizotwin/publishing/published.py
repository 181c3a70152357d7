"""Find and copy the datasets and results to be published."""

import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rhizotwin.batches.jobs import named
from rhizotwin.recon.results.result_traits import PlantTraits, traits_by_plant
from rhizotwin.scenes import atomic, folders, html_page
from rhizotwin.scenes.dataset import Dataset, load_dataset, read_image
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.monitor import Monitor
from rhizotwin.scenes.traits import Traits
from rhizotwin.stored import result_files, stored_traits

SCANS, RESULTS = "scans", "results"
"""Folders of the publication for datasets and results."""


@dataclass(frozen=True, kw_only=True)
class Scan:
    """Dataset to be published."""

    name: str
    """Name of the dataset's folder in the publication."""
    dataset: Dataset
    """Dataset with its scene and pictures."""

    @property
    def place(self) -> str:
        """Path of the dataset, relative to the folder of the publication."""
        return f"{SCANS}/{self.name}"

    @property
    def simulated(self) -> bool:
        """Whether the pictures were simulated."""
        return (self.dataset.folder / "truth").is_dir()


@dataclass(frozen=True, kw_only=True)
class Found:
    """Result to be published."""

    name: str
    """Name of the result's folder in the publication."""
    folder: Path
    """Original folder of the result."""
    summary: dict[str, Any]
    """Content of ``result.json``."""
    traits: Traits
    """Traits of the result."""
    scan: Scan | None
    """Dataset of the result. None if the dataset is not published."""

    @property
    def place(self) -> str:
        """Path of the result, relative to the folder of the publication."""
        return f"{RESULTS}/{self.name}"

    @property
    def version(self) -> str:
        """Version of the program that reconstructed the result. It is empty if it was not recorded."""
        return str(self.summary.get("versions", {}).get("rhizotwin", ""))

    @property
    def plants(self) -> list[PlantTraits]:
        """Return the traits of each plant."""
        return traits_by_plant(self.name, self.summary, self.traits)


def find(sources: Sequence[Path]) -> tuple[list[Scan], list[Found]]:
    """Find all datasets and results in folders.

    Raises
    ------
    UserError
        If a folder contains neither a dataset nor a result, or a file is damaged or a link.
    """
    scans, results = list[Path](), list[Path]()
    for source in sources:
        if not source.is_dir():
            raise UserError(f"the folder {source} does not exist; specify datasets, results, or folders that contain them")
        folders.refuse_links(source)
        inside = sorted(path for path in source.rglob("*.json") if path.name in folders.HEADS and not _is_hidden(path, source))
        if not inside:
            raise UserError(f"{source} contains neither a dataset (dataset.json) nor a result (result.json)")
        scans += [path.parent for path in inside if path.name == "dataset.json"]
        results += [path.parent for path in inside if path.name == "result.json"]
    scans, results = (list(dict.fromkeys(path.resolve() for path in found)) for found in (scans, results))
    datasets = [Scan(name=name, dataset=load_dataset(path)) for name, path in zip(named([str(p) for p in scans]), scans, strict=True)]
    by_hash = {scan.dataset.sha256: scan for scan in datasets}
    reconstructions = []
    for name, path in zip(named([str(p) for p in results]), results, strict=True):
        summary = result_files.read_summary(path)
        scan = by_hash.get(str(summary["dataset_sha256"]))
        reconstructions.append(Found(name=name, folder=path, summary=summary, traits=stored_traits.read(path), scan=scan))
    return datasets, reconstructions


def copy(scans: Sequence[Scan], results: Sequence[Found], folder: Path, *, monitor: Monitor) -> None:
    """Copy datasets and results, and check that every picture can be decoded.

    The dataset's path that is stored in a result may contain a user name, and is replaced by the path of the copy.

    Parameters
    ----------
    scans, results : sequence of Scan, sequence of Found
        Scans and results from `find`.
    folder : Path
        Folder to publish, to which the data are copied.
    monitor : Monitor
        Progress monitor.
    """
    with monitor.steps("copy", sum(len(scan.dataset.frames) for scan in scans) + len(results), "file") as step:
        for scan in scans:
            for frame in scan.dataset.frames:
                read_image(scan.dataset, frame)
                step()
            _copy_folder(scan.dataset.folder, folder / scan.place)
        for found in results:
            goal = folder / found.place
            _copy_folder(found.folder, goal)
            path = str(found.summary.get("dataset", ""))
            place = found.scan.place if found.scan else ""
            atomic.write_json(goal / "result.json", found.summary | {"dataset": place})
            if (page := goal / "report.html").is_file():
                atomic.write_bytes(page, page.read_bytes().replace(_dataset_cells(path), _dataset_cells(place)))
            step()


def _dataset_cells(path: str) -> bytes:
    """Return the cells of a report's table that state the path of the dataset.

    Other parts of the report, such as encoded pictures, may contain the same letters as the path.
    """
    return html_page.cells(("dataset", path)).encode("utf-8", "backslashreplace")


def _copy_folder(source: Path, goal: Path) -> None:
    """Copy a folder, but omit hidden files and intermediate results (``stages``)."""
    folders.refuse_links(source)
    goal.parent.mkdir(parents=True, exist_ok=True)
    shutil.copytree(source, goal, ignore=shutil.ignore_patterns(".*", "stages"))


def _is_hidden(path: Path, source: Path) -> bool:
    return any(part.startswith(".") for part in path.relative_to(source).parts)
