"""Camera of a scan: pictures, with retries on failures, and the detected strip."""

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
    """Takes pictures for a scan."""

    def __init__(self, camera: Camera, clock: Clock, scene: Scene, *, note: Callable[[str, str], None]) -> None:
        self._camera = camera
        self._clock = clock
        self._scene = scene
        self._note = note
        self._angles_deg: dict[bytes, float] = {}
        """Table angles of the pictures, by their digests."""

    def picture(self, *, table_deg: float | None = None) -> Shot:
        """Take a picture; a camera that fails is reopened and tried again, with increasing pauses.

        With ``table_deg``, the present table angle, a picture identical to one at another angle also counts as a
        failure: because of noise, no two pictures are byte-identical unless the camera hangs.

        Raises
        ------
        RigError
            If the camera fails repeatedly, or its pictures differ in size from the scene's camera.
        """
        shot = self._take_picture(table_deg)
        check_size(shot.image, self._scene.camera)
        return shot

    def look(self) -> tuple[Shot, Sighting | None]:
        """Take a picture and detect the strip in it."""
        shot = self.picture()
        return shot, read_strip(shot.image, self._scene)

    def _take_picture(self, table_deg: float | None) -> Shot:
        broken = False
        for attempt in range(TRIES):
            try:
                if broken:
                    self._camera.close()
                    self._camera.prepare()
                shot = self._camera.capture()
                if table_deg is not None:
                    digest = hashlib.sha256(shot.image.tobytes()).digest()
                    before_deg = self._angles_deg.setdefault(digest, table_deg)
                    if before_deg != table_deg:
                        raise RigError(
                            f"camera: gave the same picture at {table_deg:g} deg as at {before_deg:g} deg, byte for byte: it hangs "
                            "or shows nothing that turns; check the picture, and reconnect the camera"
                        )
                return shot
            except RigError as error:
                if attempt == TRIES - 1:
                    raise
                self._note("camera", f"{error}; trying again")
                broken = True
                self._clock.sleep(FIRST_PAUSE_S * 2**attempt)
        raise AssertionError("unreachable")
