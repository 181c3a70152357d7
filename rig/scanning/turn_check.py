"""Verification of the table's angle and of the canister in each picture of a scan, while the next picture is taken."""

from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass

from rhizotwin.rig.scanning.canister_check import HIDDEN_DEG, other_canister, shift_mm
from rhizotwin.rig.scanning.markers import Sighting, read_strip
from rhizotwin.rig.scanning.observer import Look, Observer
from rhizotwin.rig.scanning.picture_change import LEAST_SHARE, changed_share
from rhizotwin.rig.scanning.preflight import measure_exposure
from rhizotwin.rig.scanning.scan_turntable import ScanTurntable
from rhizotwin.scenes.dataset import Frame
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.picture_codec import Grey


@dataclass(frozen=True, kw_only=True)
class _Found:
    """Measurements of one picture."""

    seen: Sighting | None
    other: str | None = ""
    """Result of `canister_check.other_canister`, if the strip cannot be read."""
    changed: float | None = None


class TurnCheck:
    """Verification of the table angle of each picture with the markers, while the table moves to the next angle.

    If the strip cannot be read, it is only verified that the picture has changed, as it does when the table rotates,
    and that it does not show another canister. Pictures are also wrong if all markers of a strip that was read in all
    pictures before stay away, or if the canister is beside its place.
    """

    def __init__(self, turntable: ScanTurntable, scene: Scene, observer: Observer) -> None:
        self._turntable = turntable
        self._scene = scene
        self._observer = observer
        self._reader = ThreadPoolExecutor(max_workers=1, thread_name_prefix="reader")
        self._before: tuple[Frame, Grey] | None = None
        self._pending: tuple[Frame, Future[_Found]] | None = None
        self.unread: list[str] = []
        """Names of the picture files whose table angle was not verified with the markers."""
        self._read: list[tuple[Frame, Sighting]] = []
        self._bare: list[Frame] = []  # the latest pictures without any marker
        self._is_hidden = False  # whether a strip could not be read, and was read again

    def begin_ring(self) -> None:
        """Discard the previous picture, because the camera has moved."""
        self._before = self._pending = None
        self._read, self._bare, self._is_hidden = [], [], False

    def begin_look(self, frame: Frame, image: Grey, again: Grey | None = None) -> None:
        """Begin to check a picture. Before, `wrong` must have been called for the previous picture.

        Parameters
        ----------
        frame : Frame
            Frame of the picture.
        image : (H, W) uint8 or uint16 array
            Picture to check.
        again : (H, W) uint8 or uint16 array or None
            Second picture at the same table position, if any.
        """
        before = None if self._before is None or self._before[0].table_deg == frame.table_deg else self._before[1]
        self._pending = frame, self._reader.submit(self._look, frame, image, before, again)
        self._before = frame, image

    def wrong(self) -> tuple[list[str], str] | None:
        """Return the names of wrong pictures and their fault, or None if the last picture has no fault."""
        if self._pending is None:
            return None
        frame, looked = self._pending
        self._pending = None
        found = looked.result()
        if found.seen is not None:
            return self._wrong_place(frame, found.seen)
        if found.other:
            return [frame.file], f"{frame.file} shows another canister (markers {found.other}); put the canister of this scan back"
        self._bare = [*self._bare, frame] if found.other is None else []
        self._is_hidden = self._is_hidden or not self._bare
        if self._read and not self._is_hidden and abs((frame.table_deg or 0.0) - (self._read[-1][0].table_deg or 0.0)) > HIDDEN_DEG:
            files = [one.file for one in self._bare]
            return files, f"no marker is left since {files[0]}; put the canister back, and check that nothing hides its strip"
        if found.changed is not None and found.changed < LEAST_SHARE:
            return [frame.file], (
                f"{frame.file} does not differ from the previous picture, although the table should have turned; check that the table "
                "turns freely and that the camera does not hang"
            )
        self.unread.append(frame.file)
        return None

    def _wrong_place(self, frame: Frame, seen: Sighting) -> tuple[list[str], str] | None:
        commanded_deg = frame.table_deg or 0.0
        off_deg = self._turntable.off_deg(commanded_deg, seen)
        if abs(off_deg) > self._turntable.slip_deg:
            return [frame.file], (
                f"the markers of {frame.file} deviate by {off_deg:+.2f} deg from the commanded angle of {commanded_deg:g} deg; check that "
                "the table turns freely and that the camera did not move"
            )
        self._is_hidden = self._is_hidden or bool(self._bare)
        self._bare = []
        self._read.append((frame, seen))
        number = len(self._read)
        off_mm = self._shift_mm(number)
        if not off_mm:
            return None
        while self._shift_mm(number - 1):
            number -= 1
        return [one.file for one, _ in self._read[number - 1 :]], (
            f"the canister in {frame.file} is {off_mm:.1f} mm beside its place in the pictures before; check that the canister stands "
            "firmly and that the camera did not move"
        )

    def _shift_mm(self, number: int) -> float:
        read = self._read[:number]
        return shift_mm([frame.table_deg or 0.0 for frame, _ in read], [seen.cam_from_canister for _, seen in read], self._scene)

    def close(self) -> None:
        """Stop the background thread."""
        self._reader.shutdown(wait=True, cancel_futures=True)

    def _look(self, frame: Frame, image: Grey, before: Grey | None, again: Grey | None) -> _Found:
        seen = read_strip(image, self._scene)
        motion = None if again is None else changed_share(again, image)
        self._observer.on_look(Look(frame=frame, image=image, exposure=measure_exposure(image), sighting=seen, motion=motion))
        if seen is not None:
            return _Found(seen=seen)
        return _Found(
            seen=None, other=other_canister(image, self._scene.strip), changed=None if before is None else changed_share(image, before)
        )
