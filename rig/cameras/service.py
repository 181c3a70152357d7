"""What the camera server does, without HTTP: one camera, one session at a time, the last pictures kept."""

import hashlib
import threading
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass

from rhizotwin.rig.cameras.settings import CameraSettings
from rhizotwin.rig.devices import Camera
from rhizotwin.rig.errors import LostError, RigError
from rhizotwin.scenes.pictures import encode_png

KEPT = 4
"""Pictures kept for repeated requests; a client asks for one after the other."""


@dataclass(frozen=True, kw_only=True)
class Picture:
    """A picture ready to be sent."""

    png: bytes
    sha256: str
    exposure_s: float | None
    gain: float | None


class CameraService:
    """A camera that several requests at once may ask; each waits for its turn."""

    def __init__(self, camera: Camera, *, reopen: Callable[[CameraSettings], Camera] | None = None) -> None:
        """Take a camera over.

        Parameters
        ----------
        camera : Camera
            The camera; not open yet.
        reopen : callable or None
            Makes the camera that a session's settings ask for, in place of the one before. Without it the camera keeps
            its own.
        """
        self._camera = camera
        self._reopen = reopen
        self._session = ""
        self._pictures: OrderedDict[str, Picture] = OrderedDict()
        self._turn = threading.Lock()
        self._closed = False

    def describe(self) -> str:
        """Say what the camera is."""
        with self._turn:
            return self._camera.describe()

    def prepare(self, session: str, settings: CameraSettings) -> str:
        """Begin a session and open the camera with its settings; the same session again does nothing."""
        with self._turn:
            self._refuse_closed()
            if session != self._session:
                self._session = ""
                self._pictures.clear()
                if self._reopen is not None:
                    self._camera.close()
                    self._camera = self._reopen(settings)
                self._camera.prepare()
                self._session = session
            return self._camera.describe()

    def capture(self, session: str, name: str) -> Picture:
        """Take a picture; the same name again gives the same picture again.

        Raises
        ------
        LostError
            When the session is not the present one.
        RigError
            When the camera fails; the name is then free, and a repeated request tries again.
        """
        with self._turn:
            self._refuse_closed()
            if not self._session or session != self._session:
                raise LostError(
                    "the camera server was started again, or another computer took its camera; start the scan again with --resume"
                )
            picture = self._pictures.get(name)
            if picture is None:
                picture = self._pictures[name] = self._take()
                while len(self._pictures) > KEPT:
                    self._pictures.popitem(last=False)
            return picture

    def close(self) -> None:
        """Give the camera back, once the request at work is done; later ones are refused."""
        with self._turn:
            self._closed = True
            self._session = ""
            self._pictures.clear()
            self._camera.close()

    def _take(self) -> Picture:
        shot = self._camera.capture()
        png = encode_png(shot.image)
        return Picture(png=png, sha256=hashlib.sha256(png).hexdigest(), exposure_s=shot.exposure_s, gain=shot.gain)

    def _refuse_closed(self) -> None:
        if self._closed:
            raise RigError("the camera server is stopping; start rhizotwin camera again")
