"""Camera service independent of HTTP: one camera, one session at a time, and a cache of the last pictures."""

import hashlib
import threading
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass

from rhizotwin.rig.cameras.settings import CameraSettings
from rhizotwin.rig.devices import Camera
from rhizotwin.rig.errors import LostError, RigError
from rhizotwin.scenes.picture_codec import encode_png

KEPT = 4
"""Number of recent pictures that are stored in case a request is repeated. A client requests one picture at a time."""


@dataclass(frozen=True, kw_only=True)
class Picture:
    """Encoded picture with its checksum and exposure data."""

    png: bytes
    sha256: str
    exposure_s: float | None
    gain: float | None


class CameraService:
    """Service that processes concurrent requests to one camera sequentially."""

    def __init__(self, camera: Camera, *, reopen: Callable[[CameraSettings], Camera] | None = None) -> None:
        """Create the service for a camera.

        Parameters
        ----------
        camera : Camera
            Camera to serve, not yet open.
        reopen : callable or None
            Function that creates the camera for a session's settings, replacing the previous one. Without it the camera
            keeps its own settings.
        """
        self._camera = camera
        self._reopen = reopen
        self._session = ""
        self._pictures: OrderedDict[str, Picture] = OrderedDict()
        self._turn = threading.Lock()
        self._closed = False

    def describe(self) -> str:
        """Return a description of the camera."""
        with self._turn:
            return self._camera.describe()

    def prepare(self, session: str, settings: CameraSettings) -> str:
        """Begin a session and open the camera with its settings.

        Repeating the call for the same session has no effect.
        """
        with self._turn:
            self._check_open()
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
        """Take a picture with an identifier.

        If a picture with this identifier was already taken, return that picture.

        Raises
        ------
        LostError
            If another session has replaced this session, or the server was restarted.
        RigError
            If the camera fails. In this case the request can be repeated.
        """
        with self._turn:
            self._check_open()
            if not self._session or session != self._session:
                raise LostError(
                    "the camera server was restarted, or another computer has taken over the camera; finish the scan with --resume"
                )
            picture = self._pictures.get(name)
            if picture is None:
                picture = self._pictures[name] = self._take()
                while len(self._pictures) > KEPT:
                    self._pictures.popitem(last=False)
            return picture

    def close(self) -> None:
        """Release the camera after the current request. Later requests are rejected."""
        with self._turn:
            self._closed = True
            self._session = ""
            self._pictures.clear()
            self._camera.close()

    def _take(self) -> Picture:
        shot = self._camera.capture()
        png = encode_png(shot.image)
        return Picture(png=png, sha256=hashlib.sha256(png).hexdigest(), exposure_s=shot.exposure_s, gain=shot.gain)

    def _check_open(self) -> None:
        if self._closed:
            raise RigError("the camera server is stopping; start rhizotwin camera again")
