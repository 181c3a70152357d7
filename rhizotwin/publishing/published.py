"""What is published: datasets and results found, named, and copied."""

import html
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rhizotwin.batch.jobs import named
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
        """Folder in what is published."""
        return f"{SCANS}/{self.name}"

    @property
    def simulated(self) -> bool:
        """Whether a renderer made the pictures."""
        return (self.dataset.folder / "truth").is_dir()


@dataclass(frozen=True, kw_only=True)
class Found:
    """A result."""

    name: str
    folder: Path
    summary: dict[str, Any]
    traits: Traits
    scan: Scan | None
    """Its dataset, where that is published, too."""

    @property
    def place(self) -> str:
        """Folder in what is published."""
        return f"{RESULTS}/{self.name}"

    @property
    def plants(self) -> list[PlantTraits]:
        """Return each plant with its traits."""
        return traits_by_plant(self.name, self.summary, self.traits)


def find(sources: Sequence[Path]) -> tuple[list[Scan], list[Found]]:
    """Find datasets and results that folders are or hold.

    Raises
    ------
    UserError
        Where nothing is found, or something in it is damaged or a link.
    """
    scans, results = list[Path](), list[Path]()
    for source in sources:
        if not source.is_dir():
            raise UserError(f"{source}: there is no such folder; give datasets, results, or folders of them")
        folders.refuse_links(source)
        inside = sorted(path for path in source.rglob("*.json") if path.name in folders.HEADS and not _is_hidden(path, source))
        if not inside:
            raise UserError(f"{source}: holds no dataset and no result (dataset.json, result.json)")
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
    """Copy datasets and results; pictures are read once, so that what is damaged is not published.

    A result's path to its dataset, which names folders of a person, becomes the place of the copy.

    Parameters
    ----------
    scans, results : sequence of Scan, sequence of Found
        What `find` found.
    folder : Path
        Where copies go.
    monitor : Monitor
        Hears how far it is.

    Raises
    ------
    UserError
        For a picture that is damaged or not the one of the manifest.
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
    """Copy what is neither hidden nor a log of stages."""
    folders.refuse_links(source)
    goal.parent.mkdir(parents=True, exist_ok=True)
    shutil.copytree(source, goal, ignore=shutil.ignore_patterns(".*", "stages"))


def _is_hidden(path: Path, source: Path) -> bool:
    return any(part.startswith(".") for part in path.relative_to(source).parts)
