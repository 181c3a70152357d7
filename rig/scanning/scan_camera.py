"""Camera of a scan. It takes pictures, repeats them after failures, and reads the marker strip."""

import hashlib
from collections.abc import Callable

from rhizotwin.rig.clock import Clock
from rhizotwin.rig.devices import Camera, Shot
from rhizotwin.rig.errors import RigError
from rhizotwin.rig.scanning.markers import Sighting, read_strip
from rhizotwin.rig.scanning.preflight import check_size
from rhizotwin.scenes.model import Scene

TRIES = 3
FIRST_PAUSE_S = 1.0


class ScanCamera:
    """Camera that takes the pictures of a scan, with retries after failures."""

    def __init__(self, camera: Camera, clock: Clock, scene: Scene, *, note: Callable[[str, str], None]) -> None:
        self._camera = camera
        self._clock = clock
        self.scene = scene
        """Scene of the rig."""
        self._note = note
        self._subjects: dict[bytes, tuple[float, str]] = {}
        """Table angles, deg, and bands in which the pictures were taken. The keys are hashes of the pictures."""

    def picture(self, *, table_deg: float | None = None, band: str = "") -> Shot:
        """Take a picture. If the camera fails, it is reopened and the picture repeated, with increasing pauses.

        With ``table_deg``, the present table angle, a picture that is identical to a picture at a different angle or in
        a different band also counts as a failure. Because of noise, no two pictures are identical unless the camera
        hangs.

        Raises
        ------
        RigError
            If the camera fails repeatedly, or the size of its pictures differs from that of the scene's camera.
        """
        shot = self._take_picture(None if table_deg is None else (table_deg, band))
        check_size(shot.image, self.scene.camera)
        return shot

    def look(self) -> tuple[Shot, Sighting | None]:
        """Take a picture, and read the strip in it. The measurement is None if the strip cannot be read."""
        shot = self.picture()
        return shot, read_strip(shot.image, self.scene)

    def _take_picture(self, subject: tuple[float, str] | None) -> Shot:
        broken = False
        for attempt in range(TRIES):
            try:
                if broken:
                    self._camera.close()
                    self._camera.prepare()
                shot = self._camera.capture()
                if subject is not None:
                    digest = hashlib.sha256(shot.image.tobytes()).digest()
                    before = self._subjects.setdefault(digest, subject)
                    if before != subject:
                        raise RigError(
                            f"camera: the pictures at {_subject_text(*subject)} and {_subject_text(*before)} are identical, because the "
                            "camera hangs or shows nothing that changes; check the picture, and reconnect the camera"
                        )
                return shot
            except RigError as error:
                if attempt == TRIES - 1:
                    raise
                self._note("camera", f"{error}; trying again")
                broken = True
                self._clock.sleep(FIRST_PAUSE_S * 2**attempt)
        raise AssertionError("unreachable")


def _subject_text(table_deg: float, band: str) -> str:
    return f"{table_deg:g} deg in {band}" if band else f"{table_deg:g} deg"
