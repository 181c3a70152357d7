"""cv2.VideoCapture is stood in for by a camera that buffers frames, ignores or reverts settings, and goes away."""

from collections import deque
from dataclasses import dataclass, field

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from rhizotwin.rig.cameras import open_camera
from rhizotwin.rig.cameras.settings import CameraSettings
from rhizotwin.rig.cameras.v4l2 import V4l2Camera
from rhizotwin.rig.clock import SystemClock
from rhizotwin.rig.errors import RigError
from rhizotwin.rig.rig_file import CameraPart

BUFFERS = 4
SETTINGS = CameraSettings(image_wh=(32, 24), bits=8, exposure_s=0.0156, gain=16.0, white_balance_kelvin=4600)
ALL = {
    cv2.CAP_PROP_AUTO_EXPOSURE: 3.0,
    cv2.CAP_PROP_EXPOSURE: 250.0,
    cv2.CAP_PROP_GAIN: 64.0,
    cv2.CAP_PROP_AUTO_WB: 1.0,
    cv2.CAP_PROP_WB_TEMPERATURE: 3000.0,
    cv2.CAP_PROP_AUTOFOCUS: 1.0,
    cv2.CAP_PROP_GAMMA: 220.0,
}


@dataclass
class _Device:
    """What the fake camera is and does; one for a test."""

    there: bool = True
    controls: dict[int, float] = field(default_factory=lambda: dict(ALL))
    stuck: set[int] = field(default_factory=set)  # controls whose setting is said to have worked, and did not
    reverts: dict[int, float] = field(default_factory=dict)  # what controls go back to with the first frames
    sizes: tuple[tuple[int, int], ...] = ((32, 24), (16, 12))
    colour: tuple[int, int, int] = (100, 100, 100)
    frames_left: int = 10**6
    opened_with: list[tuple[object, int]] = field(default_factory=list)
    order: list[int] = field(default_factory=list)
    released: int = 0


class _FakeCapture:
    device: _Device

    def __init__(self, source: object, backend: int) -> None:
        self.device.opened_with.append((source, backend))
        self._size = [16, 12]
        self._fourcc = cv2.VideoWriter.fourcc(*"MJPG")
        self._waiting: deque[NDArray[np.uint8]] = deque()
        self._exposing: NDArray[np.uint8] | None = None

    def isOpened(self) -> bool:  # noqa: N802
        return self.device.there

    def set(self, prop: int, value: float) -> bool:
        self.device.order.append(prop)
        if prop == cv2.CAP_PROP_FOURCC:
            self._fourcc = int(value)
        elif prop == cv2.CAP_PROP_FRAME_WIDTH:
            self._size[0] = int(value)
        elif prop == cv2.CAP_PROP_FRAME_HEIGHT:
            wanted = (self._size[0], int(value))
            self._size = list(wanted if wanted in self.device.sizes else self.device.sizes[0])
        elif prop not in self.device.controls:
            return False
        elif prop not in self.device.stuck:
            self.device.controls[prop] = float(round(value))
        return True

    def get(self, prop: int) -> float:
        return float(self._fourcc) if prop == cv2.CAP_PROP_FOURCC else self.device.controls.get(prop, -1.0)

    def _scene(self) -> NDArray[np.uint8]:
        return np.full((self._size[1], self._size[0], 3), self.device.colour, np.uint8)

    def fill(self) -> None:
        """Fill every buffer, and expose one more frame."""
        self._waiting.extend([self._scene()] * BUFFERS)
        self._exposing = self._scene()

    def grab(self) -> bool:
        self.device.controls |= self.device.reverts
        if self.device.frames_left <= 0:
            return False
        self.device.frames_left -= 1
        if self._waiting:
            self._grabbed = self._waiting.popleft()
        else:
            self._grabbed, self._exposing = self._scene() if self._exposing is None else self._exposing, None
        return True

    def read(self) -> tuple[bool, NDArray[np.uint8] | None]:
        return (True, self._grabbed) if self.grab() else (False, None)

    def release(self) -> None:
        self.device.released += 1


@pytest.fixture
def device(monkeypatch: pytest.MonkeyPatch) -> _Device:
    found = _Device()
    monkeypatch.setattr(cv2, "VideoCapture", type("VideoCapture", (_FakeCapture,), {"device": found}))
    return found


def opened(address: str = "0", settings: CameraSettings = SETTINGS) -> V4l2Camera:
    camera = V4l2Camera(address, settings)
    camera.prepare()
    return camera


def test_everything_automatic_is_off_after_the_stream_starts(device: _Device) -> None:
    shot = opened().capture()
    assert device.controls == {
        cv2.CAP_PROP_AUTO_EXPOSURE: 1.0,
        cv2.CAP_PROP_EXPOSURE: 156.0,  # of 100 us
        cv2.CAP_PROP_GAIN: 16.0,
        cv2.CAP_PROP_AUTO_WB: 0.0,
        cv2.CAP_PROP_WB_TEMPERATURE: 4600.0,
        cv2.CAP_PROP_AUTOFOCUS: 0.0,
        cv2.CAP_PROP_GAMMA: 100.0,
    }
    assert (shot.exposure_s, shot.gain) == (pytest.approx(0.0156), 16.0)
    assert (shot.image.dtype, shot.image.shape) == (np.uint8, (24, 32))
    at = device.order.index
    assert max(at(cv2.CAP_PROP_FRAME_HEIGHT), at(cv2.CAP_PROP_BUFFERSIZE)) < min(at(prop) for prop in ALL)
    assert at(cv2.CAP_PROP_AUTO_EXPOSURE) < at(cv2.CAP_PROP_EXPOSURE)
    assert at(cv2.CAP_PROP_AUTO_WB) < at(cv2.CAP_PROP_WB_TEMPERATURE)


def test_a_picture_is_exposed_after_the_call_in_luminance(device: _Device) -> None:
    camera = opened()
    camera._capture.fill()
    device.colour = (10, 100, 200)  # blue, green, red
    image = camera.capture().image
    assert image.min() == image.max() == round(0.114 * 10 + 0.587 * 100 + 0.299 * 200)


def test_what_a_driver_says_is_not_believed(device: _Device) -> None:
    device.stuck = {cv2.CAP_PROP_EXPOSURE}
    said = r"camera /dev/video0: the settings were not applied: exposure \(in 0.1 ms\) is 250 instead of 156; .*v4l2-ctl"
    with pytest.raises(RigError, match=said):
        opened()
    assert device.released == 1


def test_settings_that_go_back_once_frames_come(device: _Device) -> None:
    camera = opened()
    camera.capture()
    device.reverts = {cv2.CAP_PROP_EXPOSURE: 80.0}
    with pytest.raises(RigError, match="is 80 instead of 156"):
        camera.capture()


def test_a_camera_may_lack_colours_and_gain_but_no_exposure(device: _Device) -> None:
    device.controls = {prop: ALL[prop] for prop in (cv2.CAP_PROP_AUTO_EXPOSURE, cv2.CAP_PROP_EXPOSURE)}
    camera = opened()
    assert camera.capture().gain is None
    assert "the gamma cannot be set to 1, so that the pictures may not be linear in light" in camera.describe()
    device.controls = {}
    with pytest.raises(RigError, match=r"automatic exposure is missing instead of 1, exposure .* is missing instead of 156"):
        opened()


def test_a_camera_that_does_not_suit_is_refused(device: _Device) -> None:
    camera = open_camera(CameraPart(kind="v4l2"), image_wh=(32, 24), bits=12, clock=SystemClock())
    with pytest.raises(RigError, match="has 8 bits, not 12; set bits = 8 in the scene's"):
        camera.prepare()
    assert not device.opened_with
    device.sizes = ((16, 12),)
    with pytest.raises(RigError, match="the pictures have 16x12 pixels instead of 32x24; set image_wh"):
        opened()
    device.there = False
    with pytest.raises(RigError, match="the camera cannot be opened; look for it with ls /dev/video"):
        opened("/dev/video7")
    assert device.opened_with == [(0, cv2.CAP_V4L2), ("/dev/video7", cv2.CAP_V4L2)]


def test_pulled_out_opened_anew_and_closed(device: _Device) -> None:
    camera = opened()
    device.frames_left = 5
    with pytest.raises(RigError, match="no longer delivers pictures; check its cable"):
        camera.capture()
    device.frames_left = 100
    camera.prepare()
    released = device.released
    camera.close()
    camera.close()
    assert device.released == released + 1
    with pytest.raises(RigError, match="not open; open it first"):
        camera.capture()
