"""A camera whose pictures are numbered, and its client."""

import threading
from dataclasses import dataclass, field

import numpy as np

from rhizotwin.rig.cameras.http import HttpCamera
from rhizotwin.rig.cameras.server import CameraServer
from rhizotwin.rig.cameras.settings import CameraSettings
from rhizotwin.rig.devices import Shot
from rhizotwin.rig.errors import RigError
from tests.rig.fake_time import Time

SETTINGS = CameraSettings(image_wh=(32, 24), bits=12, exposure_s=0.01, gain=2.0)


A, B = "a" * 32, "b" * 32


@dataclass
class NumberedCamera:
    """A camera whose pictures are numbered: each pixel is the number of the picture, four bits up."""

    taken: int = 0
    prepared: int = 0
    closed: int = 0
    dtype: type = np.uint16
    shape: tuple[int, int] = (24, 32)
    exposure_s: float | None = 0.01
    gain: float | None = 2.0
    fail: str = ""
    began: threading.Event = field(default_factory=threading.Event)
    may_end: threading.Event = field(default_factory=threading.Event)

    def __post_init__(self) -> None:
        self.may_end.set()

    def describe(self) -> str:
        """Name the camera."""
        return "camera of the test"

    def prepare(self) -> None:
        """Count, or fail if asked to."""
        self._fail()
        self.prepared += 1

    def capture(self) -> Shot:
        """Return the next picture once it may end."""
        self.began.set()
        assert self.may_end.wait(5.0)
        self._fail()
        self.taken += 1
        noise = np.random.default_rng(self.taken).integers(0, 16, self.shape)
        image = (noise * 256 + self.taken).astype(self.dtype) << (4 if self.dtype is np.uint16 else 0)
        return Shot(image=image, exposure_s=self.exposure_s, gain=self.gain)

    def close(self) -> None:
        """Count."""
        self.closed += 1

    def _fail(self) -> None:
        if self.fail:
            raise RigError(self.fail)


def number_of(shot: Shot) -> int:
    """Return the number of a picture."""
    return int(shot.image[0, 0] >> (4 if shot.image.dtype == np.uint16 else 0)) & 0xFF


def client(server: CameraServer, settings: CameraSettings = SETTINGS) -> HttpCamera:
    """Return a prepared client."""
    found = HttpCamera(server.url, settings, clock=Time())
    found.prepare()
    return found
