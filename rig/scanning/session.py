"""A scan's folder: what an earlier run left is taken up, and every picture is written at once, whole or not at all.

A frame is listed in dataset.json before its picture is written; a listed frame without its picture never reached the
disk, is dropped when the scan is taken up, and is taken again. Pictures are encoded and written beside the next
movement, one at a time and in order.
"""

import hashlib
import json
from collections.abc import Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from rhizotwin.rig.rig_file import RigFile
from rhizotwin.scenes import plan
from rhizotwin.scenes.atomic import write_bytes
from rhizotwin.scenes.dataset import Dataset, Frame, load_dataset, save_dataset, sha256_of
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.folders import contents
from rhizotwin.scenes.model import Disturbances, Scene
from rhizotwin.scenes.pictures import Grey, encode_png
from rhizotwin.scenes.plan import View
from rhizotwin.scenes.provenance import versions
from rhizotwin.scenes.schema import to_plain

PROGRAM = "rhizotwin scan"
_VERSIONED = ("numpy", "opencv-python-headless", "pyserial")
_MAY_CHANGE = {("name",), ("description",), ("turntable", "port"), ("arm", "port"), ("camera", "address")}
"""What may differ in the rig file when a scan is taken up: a device plugged in again has another name."""
_MOST_NAMED = 4


class Session:
    """The frames of a scan, on the disk and still to be taken."""

    def __init__(self, dataset: Dataset, planned: Sequence[View]) -> None:
        self._dataset = replace(dataset, frames=())
        self._frames = {frame.file: frame for frame in dataset.frames}
        self._planned = tuple(planned)
        self._writer = ThreadPoolExecutor(max_workers=1, thread_name_prefix="writer")
        self._pending: Future[None] | None = None
        self._begun_s = max((frame.time_s or 0.0 for frame in dataset.frames), default=0.0)

    @property
    def folder(self) -> Path:
        """The dataset folder."""
        return self._dataset.folder

    @property
    def begun_s(self) -> float:
        """Time of the scan that earlier runs used up."""
        return self._begun_s

    def last_station(self) -> list[Frame]:
        """Return the frames that the camera took from the place where it stood last, in the order they were taken.

        Of a view in several bands, the one with both lights on.
        """
        taken = sorted(self._frames.values(), key=lambda frame: frame.time_s or 0.0)
        return [frame for frame in taken if frame.station == taken[-1].station and self._is_main(frame)]

    def remaining(self) -> list[View]:
        """Return the views that have no picture yet."""
        self.flush()
        return [view for view in self._planned if any(file not in self._frames for file in self._files_of(view))]

    def next_placement(self, ring: int) -> int:
        """Return the number of a new placement of the camera in a ring."""
        return 1 + max((frame.placement for frame in self._frames.values() if frame.ring == ring), default=-1)

    def frames_of(self, ring: int) -> list[Frame]:
        """Return a ring's frames that are on the disk; of a view in several bands, the one with both lights on."""
        self.flush()
        return [frame for frame in self._frames.values() if frame.ring == ring and self._is_main(frame)]

    def dataset(self) -> Dataset:
        """Return the dataset as it is, frames in the order of the plan."""
        self.flush()
        return self._snapshot()

    def note(self, event: str, text: str, *, time_s: float) -> None:
        """Keep an event in the log; it is written with the next frame, or by `save`.

        Parameters
        ----------
        event, text : str
            What it was, for programs and for people.
        time_s : float
            Since the scan began.
        """
        said = {"event": event, "text": text, "scan_s": round(time_s, 3), "utc": datetime.now(UTC).isoformat(timespec="seconds")}
        self._dataset = replace(self._dataset, origin={**self._dataset.origin, "log": [*self._dataset.origin["log"], said]})

    def record(self, frame: Frame, image: Grey) -> None:
        """Begin to write a frame and its picture, once the one before is written.

        What went wrong with that is raised here.
        """
        self.flush()
        self._pending = self._writer.submit(self._write, frame, image)

    def drop(self, files: Sequence[str]) -> None:
        """Take pictures out that turned out wrong, in all bands of their views; they are taken again."""
        self.flush()
        views = {self._frames[file].view for file in files if file in self._frames} - {None}
        for file in {
            *files,
            *(frame.file for frame in self._frames.values() if frame.view in views),
        }:  # before the list: a listed picture that is missing is taken again as well
            (self.folder / file).unlink(missing_ok=True)
            self._frames.pop(file, None)
        if self._frames:
            save_dataset(self._snapshot())
        else:
            (self.folder / "dataset.json").unlink(missing_ok=True)

    def flush(self) -> None:
        """Wait until everything is on the disk.

        Raises
        ------
        UserError
            When the last picture could not be written.
        """
        pending = self._pending
        if pending is not None:
            try:
                pending.result()
            finally:
                if pending.done():  # otherwise stopped while waiting: the picture is still being written
                    self._pending = None

    def save(self, *, complete: bool = False) -> Dataset:
        """Write the log, and whether the scan is finished, beside the frames."""
        self.flush()
        if complete:
            self._dataset = replace(self._dataset, origin={**self._dataset.origin, "complete": True})
        dataset = self._snapshot()
        return save_dataset(dataset) if dataset.frames else dataset  # a dataset has at least one

    def close(self) -> None:
        """Wait for the writer."""
        self._writer.shutdown(wait=True)

    def _write(self, frame: Frame, image: Grey) -> None:
        data = encode_png(image)
        self._frames[frame.file] = replace(frame, sha256=hashlib.sha256(data).hexdigest())
        save_dataset(self._snapshot())
        write_bytes(self.folder / frame.file, data)

    def _snapshot(self) -> Dataset:
        found = (self._frames.get(file) for view in self._planned for file in self._files_of(view))
        return replace(self._dataset, frames=tuple(frame for frame in found if frame is not None))

    def _files_of(self, view: View) -> list[str]:
        return [file_of(view, band) for band in plan.bands_of(self._dataset.scene, view.ring)]

    def _is_main(self, frame: Frame) -> bool:
        return frame.band == plan.main_band(self._dataset.scene, frame.ring)


def _stopped(folder: Path, resume: bool) -> Dataset:
    """Return what a stopped scan left in a folder; refuse it unless it is to be taken up."""
    before = load_dataset(folder)
    if before.origin.get("program") != PROGRAM:
        raise UserError(f"{folder} holds a dataset that was not made by scanning: choose a new folder for the scan")
    if not resume:
        state = "a finished scan" if before.origin.get("complete") else f"a scan that was stopped after {len(before.frames)} pictures"
        hint = "" if before.origin.get("complete") else "add --resume to finish it, or "
        raise UserError(f"{folder} holds {state}: {hint}choose a new folder")
    return before


def take_up(
    folder: Path,
    scene: Scene,
    planned: Sequence[View],
    *,
    rig: RigFile,
    settings: Mapping[str, Any],
    seed: int | None = None,
    resume: bool = False,
) -> Session:
    """Begin a scan in a new folder, or take up the one that was stopped there.

    Parameters
    ----------
    folder : path
        New or empty; or left by a scan that was stopped, with ``resume``; held by the caller
        (`scenes.folders.held`).
    scene : Scene
        As given; what stands in the canister is left out of the dataset.
    planned : sequence of View
        The views to take.
    rig, settings : RigFile, mapping of object
        What the scan is made with, compared with what it was begun with.
    seed : int or None
        Of the twin's errors.
    resume : bool
        Whether a stopped scan is taken up; without frames in the folder it begins as a new one.

    Raises
    ------
    UserError
        When the folder holds something else, or a scan of another scene, plan, rig or other settings: the differences
        are named.
    """
    folder = Path(folder)
    origin: dict[str, Any] = {
        "program": PROGRAM,
        "rig": to_plain(rig),
        "settings": dict(settings),
        "versions": versions(_VERSIONED),
        "complete": False,
        "planned_views": len(planned),
        "log": [],
    }
    known = replace(scene, description="", specimen=None, disturbances=Disturbances())
    new = Dataset(folder=folder, scene=known, frames=(), seed=seed, origin=origin)
    if not (folder / "dataset.json").is_file():
        inside = [path for name in contents(folder) if name != "truth" for path in [folder / name, *(folder / name).rglob("*")]]
        if any(path.is_file() for path in inside):
            raise UserError(f"{folder} is not empty and holds no stopped scan: choose a new folder for the dataset")
        return Session(new, planned)
    before = _stopped(folder, resume)
    _refuse_differences(before, new)
    kept = tuple(frame for frame in before.frames if _is_whole(folder, frame))
    strange = {frame.file for frame in kept} - {file_of(view, band) for view in planned for band in plan.bands_of(known, view.ring)}
    if strange:
        raise UserError(f"{folder} holds {sorted(strange)[0]}, which the plan does not have: choose a new folder for the scan")
    complete = bool(before.origin.get("complete")) and len(kept) == sum(len(plan.bands_of(known, view.ring)) for view in planned)
    return Session(replace(before, frames=kept, origin={**origin, **before.origin, "rig": origin["rig"], "complete": complete}), planned)


def file_of(view: View, band: str = "") -> str:
    """Return the path of a view's picture in the dataset."""
    return f"images/{plan.picture_name(view.index, band)}.png"


def _is_whole(folder: Path, frame: Frame) -> bool:
    """Tell whether a listed frame's picture is there.

    One that is there, but not the recorded one, is refused by name.
    """
    path = folder / frame.file
    if not path.is_file():
        return False
    if frame.sha256 and sha256_of(path) != frame.sha256:
        raise UserError(f"{path}: is not the picture that was recorded; remove it, then it is taken again")
    return True


def _refuse_differences(before: Dataset, now: Dataset) -> None:
    """Refuse to mix pictures of different scenes, plans, rigs or settings in one dataset."""
    found = _differences(to_plain(before.scene), to_plain(now.scene), ())
    found = [("scene", *path) for path in found if path not in (("name",), ("description",))]
    rig = _differences(before.origin.get("rig", {}), now.origin["rig"], ())
    found += [("rig", *path) for path in rig if path not in _MAY_CHANGE]
    settings = json.loads(json.dumps(now.origin["settings"]))
    found += _differences({**before.origin.get("settings", {}), "seed": before.seed}, {**settings, "seed": now.seed}, ())
    if found:
        names = ", ".join(".".join(path) for path in found[:_MOST_NAMED]) + (" and more" if len(found) > _MOST_NAMED else "")
        raise UserError(f"{now.folder} holds a scan that was begun with another {names}: give the same as then, or choose a new folder")


def _differences(before: Any, now: Any, path: tuple[str, ...]) -> list[tuple[str, ...]]:
    """Return the paths of values that differ."""
    if isinstance(before, Mapping) and isinstance(now, Mapping):
        names = [*before, *(name for name in now if name not in before)]
        return [found for name in names for found in _differences(before.get(name), now.get(name), (*path, str(name)))]
    if isinstance(before, list) and isinstance(now, list) and len(before) == len(now):
        pairs = enumerate(zip(before, now, strict=True), start=1)
        return [found for i, (old, new) in pairs for found in _differences(old, new, (*path, str(i)))]
    return [] if before == now else [path]
