"""Datasets and results to be published: search, names, and copies."""

import html
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rhizotwin.batches.jobs import named
from rhizotwin.recon.results.result_traits import PlantTraits, traits_by_plant
from rhizotwin.scenes import atomic, folders
from rhizotwin.scenes.dataset import Dataset, load_dataset, read_image
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.monitor import Monitor
from rhizotwin.scenes.traits import Traits
from rhizotwin.stored import result_files, stored_traits

SCANS, RESULTS = "scans", "results"


@dataclass(frozen=True, kw_only=True)
class Scan:
    """A dataset."""

    name: str
    dataset: Dataset

    @property
    def place(self) -> str:
        """Folder in the publication."""
        return f"{SCANS}/{self.name}"

    @property
    def simulated(self) -> bool:
        """Whether the pictures were rendered."""
        return (self.dataset.folder / "truth").is_dir()


@dataclass(frozen=True, kw_only=True)
class Found:
    """A result."""

    name: str
    folder: Path
    summary: dict[str, Any]
    traits: Traits
    scan: Scan | None
    """Dataset of the result, if published, too."""

    @property
    def place(self) -> str:
        """Folder in the publication."""
        return f"{RESULTS}/{self.name}"

    @property
    def plants(self) -> list[PlantTraits]:
        """Return each plant with its traits."""
        return traits_by_plant(self.name, self.summary, self.traits)


def find(sources: Sequence[Path]) -> tuple[list[Scan], list[Found]]:
    """Find the datasets and results in folders.

    Raises
    ------
    UserError
        If nothing is found, or a file is damaged or a link.
    """
    scans, results = list[Path](), list[Path]()
    for source in sources:
        if not source.is_dir():
            raise UserError(f"the folder {source} does not exist; give datasets, results, or folders that contain them")
        folders.refuse_links(source)
        inside = sorted(path for path in source.rglob("*.json") if path.name in folders.HEADS and not _is_hidden(path, source))
        if not inside:
            raise UserError(f"{source} contains no dataset and no result (dataset.json, result.json)")
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
    """Copy datasets and results; every picture is decoded once, so that no damaged picture is published.

    The path of a result's dataset, which may contain personal folder names, is replaced by the path of the copy.

    Parameters
    ----------
    scans, results : sequence of Scan, sequence of Found
        Scans and results from `find`.
    folder : Path
        Folder of the copies.
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
            path, place = str(found.summary.get("dataset", "")), found.scan.place if found.scan else ""
            atomic.write_json(goal / "result.json", found.summary | {"dataset": place})
            if path and (page := goal / "report.html").is_file():
                text = page.read_text(encoding="utf-8", errors="surrogateescape").replace(html.escape(path), html.escape(place))
                atomic.write_bytes(page, text.encode("utf-8", "surrogateescape"))
            step()


def _copy_folder(source: Path, goal: Path) -> None:
    """Copy a folder without hidden files and logs."""
    folders.refuse_links(source)
    goal.parent.mkdir(parents=True, exist_ok=True)
    shutil.copytree(source, goal, ignore=shutil.ignore_patterns(".*", "stages"))


def _is_hidden(path: Path, source: Path) -> bool:
    return any(part.startswith(".") for part in path.relative_to(source).parts)
