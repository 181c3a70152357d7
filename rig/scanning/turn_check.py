"""Verification that the table has rotated before each picture of a scan. It is done while the next picture is taken."""

from concurrent.futures import Future, ThreadPoolExecutor

from rhizotwin.rig.scanning.markers import Sighting, read_strip
from rhizotwin.rig.scanning.observer import Look, Observer
from rhizotwin.rig.scanning.picture_change import LEAST_SHARE, changed_share
from rhizotwin.rig.scanning.preflight import measure_exposure
from rhizotwin.rig.scanning.scan_turntable import ScanTurntable
from rhizotwin.scenes.dataset import Frame
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.picture_codec import Grey


class TurnCheck:
    """Verification of the table angle of each picture with the markers, while the table moves to the next angle.

    If the strip cannot be read, it is only verified that the picture has changed, as it does when the table rotates.
    """

    def __init__(self, turntable: ScanTurntable, scene: Scene, observer: Observer) -> None:
        self._turntable = turntable
        self._scene = scene
        self._observer = observer
        self._reader = ThreadPoolExecutor(max_workers=1, thread_name_prefix="reader")
        self._before: tuple[Frame, Grey] | None = None
        self._pending: tuple[Frame, Future[tuple[Sighting | None, float | None]]] | None = None
        self.unread: list[str] = []
        """Names of the picture files whose table angle was not verified with the markers."""

    def begin_ring(self) -> None:
        """Discard the previous picture, because the camera has moved."""
        self._before = self._pending = None

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

    def wrong(self) -> tuple[str, str] | None:
        """Return the file name and the fault of the last picture, or None if it has no fault."""
        if self._pending is None:
            return None
        frame, looked = self._pending
        self._pending = None
        seen, changed = looked.result()
        commanded_deg = frame.table_deg or 0.0
        if seen is not None:
            off_deg = self._turntable.off_deg(commanded_deg, seen)
            if abs(off_deg) > self._turntable.slip_deg:
                return (
                    frame.file,
                    f"the markers of {frame.file} deviate by {off_deg:+.2f} deg from the commanded angle of {commanded_deg:g} deg",
                )
            return None
        if changed is not None and changed < LEAST_SHARE:
            return frame.file, f"{frame.file} does not differ from the previous picture, although the table should have turned"
        self.unread.append(frame.file)
        return None

    def close(self) -> None:
        """Stop the background thread."""
        self._reader.shutdown(wait=True, cancel_futures=True)

    def _look(self, frame: Frame, image: Grey, before: Grey | None, again: Grey | None) -> tuple[Sighting | None, float | None]:
        seen = read_strip(image, self._scene)
        motion = None if again is None else changed_share(again, image)
        self._observer.on_look(Look(frame=frame, image=image, exposure=measure_exposure(image), sighting=seen, motion=motion))
        return seen, None if seen is not None or before is None else changed_share(image, before)
