"""What the stages of a reconstruction share: the data at hand, the bars, the clock, and what is to be said at the end."""

import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

from tqdm import tqdm

from rhizotwin.recon.coverage.translucency import Law
from rhizotwin.recon.device import threads
from rhizotwin.recon.tubes.root_calibration import RigDoubt, RootCalibration
from rhizotwin.scenes.dataset import Dataset, Frame, load_dataset, read_image
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Camera
from rhizotwin.scenes.pictures import Grey

T = TypeVar("T")


@dataclass
class Run:
    """One reconstruction under way."""

    dataset: Dataset
    frames: list[Frame]
    """The pictures of the root."""
    progress: bool
    images: list[Grey] = field(default_factory=list, repr=False)
    """Pictures (H, W) as stored, one a frame."""
    timings_s: dict[str, float] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)
    camera: Camera = field(init=False)
    """The lens: as given, until the pictures tell how it was focused."""
    doubt: RigDoubt | None = None
    """How well the pictures tell the rig, by frame; None: cameras were given."""
    law: Law | None = None
    """How roots that are wide enough to tell look before the backlight; None: the pictures were silhouettes already."""
    asked_roots: RootCalibration | None = None
    """What the roots said about the rig."""

    def __post_init__(self) -> None:
        self.camera = self.dataset.scene.camera

    @classmethod
    def of(cls, dataset_folder: Path, *, progress: bool) -> "Run":
        """Open a dataset and read its pictures of the root.

        Raises
        ------
        UserError
            Where the dataset or a picture is missing or damaged.
        """
        dataset = load_dataset(dataset_folder)
        run = cls(dataset, [frame for frame in dataset.frames if frame.kind == "root"], progress)
        if not run.frames:
            raise UserError(f"{dataset.folder / 'dataset.json'} lists no pictures of the root; take or import some.")
        with run.stage("read"):
            run.images = run.each(lambda k: read_image(dataset, run.frames[k]), "read", list(range(len(run.frames))))
        return run

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time a stage."""
        begin = time.perf_counter()
        yield
        self.timings_s[name] = time.perf_counter() - begin

    def bar(self, name: str, total: int, unit: str) -> "tqdm[None]":
        """Return a progress bar with the time left on stderr."""
        return tqdm(total=total, desc=name, unit=unit, disable=not self.progress, dynamic_ncols=True)

    def each(self, work: Callable[[int], T], name: str, indices: list[int]) -> list[T]:
        """Do something for views in parallel, with a bar."""
        with ThreadPoolExecutor(max_workers=threads()) as pool, self.bar(name, len(indices), "view") as bar:
            done = []
            try:
                for item in pool.map(work, indices):
                    done.append(item)
                    bar.update()
            except BaseException:
                pool.shutdown(wait=False, cancel_futures=True)
                raise
            return done
