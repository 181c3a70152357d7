"""Whether the pictures of a scan show that the table turned, told while the next one is being taken."""

from concurrent.futures import Future, ThreadPoolExecutor

from rhizotwin.rig.scanning.change import LEAST_SHARE, changed_share
from rhizotwin.rig.scanning.markers import Sighting, read_strip
from rhizotwin.rig.scanning.onlooker import Look, Onlooker
from rhizotwin.rig.scanning.preflight import exposure_of
from rhizotwin.rig.scanning.turning import Turning
from rhizotwin.scenes.dataset import Frame
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.pictures import Grey


class Watch:
    """Reads the strip in each picture beside the next movement.

    Without a strip it looks whether the picture changed with the turn.
    """

    def __init__(self, turning: Turning, scene: Scene, onlooker: Onlooker) -> None:
        self._turning = turning
        self._scene = scene
        self._onlooker = onlooker
        self._reader = ThreadPoolExecutor(max_workers=1, thread_name_prefix="reader")
        self._before: tuple[Frame, Grey] | None = None
        self._pending: tuple[Frame, Future[tuple[Sighting | None, float | None]]] | None = None
        self.unread: list[str] = []
        """Files whose angle no marker proves."""

    def begin_ring(self) -> None:
        """Forget the picture before: the camera stands elsewhere now."""
        self._before = self._pending = None

    def begin_look(self, frame: Frame, image: Grey, again: Grey | None = None) -> None:
        """Begin to look at a picture; what was found of the one before must have been read (`wrong`).

        Parameters
        ----------
        frame : Frame
            The picture's place in the plan.
        image : (H, W) uint8 or uint16 array
            The picture.
        again : (H, W) uint8 or uint16 array or None
            A second picture at the same stop; None where none was taken.
        """
        before = None if self._before is None or self._before[0].table_deg == frame.table_deg else self._before[1]
        self._pending = frame, self._reader.submit(self._look, frame, image, before, again)
        self._before = frame, image

    def wrong(self) -> tuple[str, str] | None:
        """Return the file of the last picture and what is wrong with it; None when it shows what it should."""
        if self._pending is None:
            return None
        frame, looked = self._pending
        self._pending = None
        seen, changed = looked.result()
        commanded_deg = frame.table_deg or 0.0
        if seen is not None:
            off_deg = self._turning.off_deg(commanded_deg, seen)
            if abs(off_deg) > self._turning.slip_deg:
                return frame.file, f"the markers of {frame.file} show {off_deg:+.2f} deg beside the commanded {commanded_deg:g} deg"
            return None
        if changed is not None and changed < LEAST_SHARE:
            return frame.file, f"{frame.file} looks like the picture before, although the table was turned"
        self.unread.append(frame.file)
        return None

    def close(self) -> None:
        """End the reader."""
        self._reader.shutdown(wait=True, cancel_futures=True)

    def _look(self, frame: Frame, image: Grey, before: Grey | None, again: Grey | None) -> tuple[Sighting | None, float | None]:
        seen = read_strip(image, self._scene)
        motion = None if again is None else changed_share(again, image)
        self._onlooker.on_look(Look(frame=frame, image=image, exposure=exposure_of(image), sighting=seen, motion=motion))
        return seen, None if seen is not None or before is None else changed_share(image, before)
