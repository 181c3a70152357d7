"""Folder of a scan. A scan that was interrupted can be resumed in the same folder.

Every picture is written atomically, immediately after it was taken. A frame is listed in dataset.json before its
picture is written. If the picture of a listed frame is missing, it was never written; the frame is removed when the
scan is resumed, and taken again. Pictures are encoded and written during the next movement, one at a time and in order.
"""

import hashlib
import json
from collections.abc import Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from rhizotwin.rig.rig_file import RigFile
from rhizotwin.scenes import plan
from rhizotwin.scenes.atomic import write_bytes
from rhizotwin.scenes.dataset import Dataset, Frame, file_sha256, load_dataset, save_dataset
from rhizotwin.scenes.disturbances import Disturbances
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.folders import contents
from rhizotwin.scenes.formatting import count
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.picture_codec import Grey, encode_png
from rhizotwin.scenes.plan import View
from rhizotwin.scenes.provenance import versions
from rhizotwin.scenes.schema import Place, from_plain, to_plain

PROGRAM = "rhizotwin scan"
_VERSIONED = ("numpy", "opencv-python-headless", "pyserial")
_MAY_CHANGE = {("name",), ("description",), ("turntable", "port"), ("arm", "port"), ("camera", "address")}
"""Keys of the rig file that may change when a scan is resumed, since reconnected devices may have different names."""
_MOST_NAMED = 4


class Session:
    """Stored frames of a scan, and views that remain to be taken."""

    def __init__(self, dataset: Dataset, planned: Sequence[View]) -> None:
        self._dataset = replace(dataset, frames=())
        self._frames = {frame.file: frame for frame in dataset.frames}
        self._planned = tuple(planned)
        self._writer = ThreadPoolExecutor(max_workers=1, thread_name_prefix="writer")
        self._pending: Future[None] | None = None
        self._begun_s = max((frame.time_s or 0.0 for frame in dataset.frames), default=0.0)

    @property
    def folder(self) -> Path:
        """Folder of the dataset."""
        return self._dataset.folder

    @property
    def begun_s(self) -> float:
        """Total duration of all earlier runs of the scan, s."""
        return self._begun_s

    def last_station(self) -> list[Frame]:
        """Return the frames taken from the camera's last position, in the order of capture.

        If views are taken in several bands, only the band with both lights on is included.
        """
        taken = sorted(self._frames.values(), key=lambda frame: frame.time_s or 0.0)
        return [frame for frame in taken if frame.station == taken[-1].station and self._is_main(frame)]

    def remaining(self) -> list[View]:
        """Return the views of the plan that have no picture yet."""
        self.flush()
        return [view for view in self._planned if any(file not in self._frames for file in self._view_files(view))]

    def next_placement(self, ring: int) -> int:
        """Return the number of the camera's next placement in a ring."""
        self.flush()
        return 1 + max((frame.placement for frame in self._frames.values() if frame.ring == ring), default=-1)

    def frames_of(self, ring: int) -> list[Frame]:
        """Return the stored frames of a ring.

        If views are taken in several bands, only the band with both lights on is included.
        """
        self.flush()
        return [frame for frame in self._frames.values() if frame.ring == ring and self._is_main(frame)]

    def dataset(self) -> Dataset:
        """Return the present dataset, with frames in the order of the plan."""
        self.flush()
        return self._snapshot()

    def note(self, event: str, text: str, *, time_s: float) -> None:
        """Add an event to the log. The log is written with the next frame, or by `save`.

        Parameters
        ----------
        event, text : str
            Identifier of the event, and its description.
        time_s : float
            Time since the start of the scan, s.
        """
        said = {"event": event, "text": text, "scan_s": round(time_s, 3), "utc": datetime.now(UTC).isoformat(timespec="seconds")}
        self._dataset = replace(self._dataset, origin={**self._dataset.origin, "log": [*self._dataset.origin["log"], said]})

    def record(self, frame: Frame, image: Grey) -> None:
        """Begin to write a frame and its picture in the background.

        The method first waits until the previous picture is written. Errors in writing the previous picture are raised
        here.
        """
        self.flush()
        self._pending = self._writer.submit(self._write, frame, image)

    def drop(self, files: Sequence[str]) -> None:
        """Remove wrong pictures, together with those of the same views in other bands. They are taken again."""
        self.flush()
        views = {self._frames[file].view for file in files if file in self._frames} - {None}
        for file in {
            *files,
            *(frame.file for frame in self._frames.values() if frame.view in views),
        }:  # files are removed before the list changes, because a listed picture that is missing is also taken again
            (self.folder / file).unlink(missing_ok=True)
            self._frames.pop(file, None)
        if self._frames:
            save_dataset(self._snapshot())
        else:
            (self.folder / "dataset.json").unlink(missing_ok=True)

    def flush(self) -> None:
        """Wait until all data are written to the disk.

        Raises
        ------
        UserError
            If the last picture could not be written.
        """
        pending = self._pending
        if pending is not None:
            try:
                pending.result()
            finally:
                if pending.done():  # otherwise the waiting was interrupted, and the picture is still being written
                    self._pending = None

    def save(self, *, complete: bool = False) -> Dataset:
        """Write the frames, the log, and whether the scan is complete. Return the dataset."""
        self.flush()
        if complete:
            self._dataset = replace(self._dataset, origin={**self._dataset.origin, "complete": True})
        dataset = self._snapshot()
        return save_dataset(dataset) if dataset.frames else dataset  # a dataset has at least one frame

    def close(self) -> None:
        """Wait until the last picture is written, and stop the writer."""
        self._writer.shutdown(wait=True)

    def _write(self, frame: Frame, image: Grey) -> None:
        data = encode_png(image)
        self._frames[frame.file] = replace(frame, sha256=hashlib.sha256(data).hexdigest())
        save_dataset(self._snapshot())
        write_bytes(self.folder / frame.file, data)

    def _snapshot(self) -> Dataset:
        found = (self._frames.get(file) for view in self._planned for file in self._view_files(view))
        return replace(self._dataset, frames=tuple(frame for frame in found if frame is not None))

    def _view_files(self, view: View) -> list[str]:
        return [picture_file(view, band) for band in plan.ring_bands(self._dataset.scene, view.ring)]

    def _is_main(self, frame: Frame) -> bool:
        return frame.band == plan.main_band(self._dataset.scene, frame.ring)


def _load_stopped(folder: Path, resume: bool) -> Dataset:
    """Return the dataset of an interrupted scan in a folder.

    Raise an error if the scan is not to be resumed.
    """
    before = load_dataset(folder)
    if before.origin.get("program") != PROGRAM:
        raise UserError(f"{folder} contains a dataset that was not created by a scan; choose a new folder for the scan")
    if not resume:
        if before.origin.get("complete"):
            raise UserError(f"{folder} contains a finished scan; choose a new folder")
        taken = count(len(before.frames), "picture")
        raise UserError(f"{folder} contains a scan that was interrupted after {taken}; add --resume to finish it, or choose a new folder")
    return before


@dataclass(frozen=True, kw_only=True)
class Origin:
    """Source of a scan's pictures, beside scene and rig. It is compared when the scan is resumed."""

    settings: Mapping[str, Any] = field(default_factory=dict)
    """Further settings of the scan, which are written to the dataset."""
    seed: int | None = None
    """Random seed of the twin's errors."""


def open_session(
    folder: Path, scene: Scene, planned: Sequence[View], *, rig: RigFile, origin: Origin = Origin(), resume: bool = False
) -> Session:
    """Begin a scan in a new folder, or resume an interrupted scan in its folder.

    Parameters
    ----------
    folder : path
        New or empty folder or, with ``resume``, the folder of an interrupted scan. The caller must lock it with
        `scenes.folders.lock_folder`.
    scene : Scene
        Scene of the scan. The dataset does not include the specimen.
    planned : sequence of View
        Views to take.
    rig, origin : RigFile, Origin
        Rig of the scan, and source of its pictures. They must not change when a scan is resumed.
    resume : bool
        Whether to resume an interrupted scan. If the folder has no frames, a new scan begins.

    Raises
    ------
    UserError
        If the folder contains other files, or a scan with a different scene, plan, rig or settings; the message states
        the differences.
    """
    folder = Path(folder)
    about: dict[str, Any] = {
        "program": PROGRAM,
        "rig": to_plain(rig),
        "settings": dict(origin.settings),
        "versions": versions(_VERSIONED),
        "complete": False,
        "planned_views": len(planned),
        "log": [],
    }
    known = replace(scene, description="", specimen=None, disturbances=Disturbances())
    new = Dataset(folder=folder, scene=known, frames=(), seed=origin.seed, origin=about)
    if not (folder / "dataset.json").is_file():
        inside = [path for name in contents(folder) if name != "truth" for path in [folder / name, *(folder / name).rglob("*")]]
        if any(path.is_file() for path in inside):
            raise UserError(f"{folder} is not empty and contains no interrupted scan; choose a new folder for the dataset")
        return Session(new, planned)
    before = _load_stopped(folder, resume)
    _check_differences(before, new)
    kept = tuple(frame for frame in before.frames if _is_complete(folder, frame))
    files = {picture_file(view, band) for view in planned for band in plan.ring_bands(known, view.ring)}
    strange = {frame.file for frame in kept} - files
    if strange:
        raise UserError(f"{folder} contains {sorted(strange)[0]}, which is not part of the plan; choose a new folder for the scan")
    complete = bool(before.origin.get("complete")) and len(kept) == len(files)
    return Session(replace(before, frames=kept, origin={**about, **before.origin, "rig": about["rig"], "complete": complete}), planned)


def picture_file(view: View, band: str = "") -> str:
    """Return the path of a view's picture, relative to the dataset's folder."""
    return f"images/{plan.picture_name(view.index, band)}.png"


def _is_complete(folder: Path, frame: Frame) -> bool:
    """Return whether the picture of a recorded frame exists. Raise an error if its contents have changed."""
    path = folder / frame.file
    if not path.is_file():
        return False
    if frame.sha256 and file_sha256(path) != frame.sha256:
        raise UserError(f"{path} differs from the recorded picture; remove it, so that it is taken again")
    return True


def _check_differences(before: Dataset, now: Dataset) -> None:
    """Raise an error if the scene, the plan, the rig or the settings have changed since a scan began."""
    found = _differences(to_plain(before.scene), to_plain(now.scene), ())
    found = [("scene", *path) for path in found if path not in (("name",), ("description",))]
    rig = _differences(_with_new_keys(before.origin.get("rig", {})), now.origin["rig"], ())
    found += [("rig", *path) for path in rig if path not in _MAY_CHANGE]
    settings = json.loads(json.dumps(now.origin["settings"]))
    found += _differences({**before.origin.get("settings", {}), "seed": before.seed}, {**settings, "seed": now.seed}, ())
    if found:
        names = ", ".join(".".join(path) for path in found[:_MOST_NAMED]) + (" and more" if len(found) > _MOST_NAMED else "")
        raise UserError(f"{now.folder} contains a scan with different values of {names}; use the same values, or choose a new folder")


def _with_new_keys(rig: Any) -> Any:
    """Return the rig of an earlier run, with defaults for keys that an update of the program has added."""
    try:
        return to_plain(from_plain(RigFile, rig, Place("rig")))
    except UserError:
        return rig


def _differences(before: Any, now: Any, path: tuple[str, ...]) -> list[tuple[str, ...]]:
    """Return the paths of all values that differ between two nested objects."""
    if isinstance(before, Mapping) and isinstance(now, Mapping):
        names = [*before, *(name for name in now if name not in before)]
        return [found for name in names for found in _differences(before.get(name), now.get(name), (*path, str(name)))]
    if isinstance(before, list) and isinstance(now, list) and len(before) == len(now):
        pairs = enumerate(zip(before, now, strict=True), start=1)
        return [found for i, (old, new) in pairs for found in _differences(old, new, (*path, str(i)))]
    return [] if before == now else [path]
