"""picamera2 is stood in for by a module that behaves as the real one: frames in time, settings that come late, stale frames, metadata."""

import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from rhizotwin.rig.cameras import open_camera
from rhizotwin.rig.cameras.bayer import grey_from_bayer
from rhizotwin.rig.cameras.pi import TRIES, PiCamera
from rhizotwin.rig.cameras.pi_frames import choose_mode
from rhizotwin.rig.cameras.settings import CameraSettings
from rhizotwin.rig.clock import SystemClock
from rhizotwin.rig.errors import RigError
from rhizotwin.rig.rig_file import CameraPart

FRAME_NS = 100_000_000
BLACK, WHITE = 256, 4095  # of the 12-bit sensor
AUTOMATIC = {"ExposureTime": 20000, "AnalogueGain": 4.0, "ColourGains": (1.3, 1.6)}
IMX477 = [
    {"format": "SRGGB12_CSI2P", "unpacked": "SRGGB12", "bit_depth": 12, "size": (2028, 1080)},
    {"format": "SRGGB12_CSI2P", "unpacked": "SRGGB12", "bit_depth": 12, "size": (2028, 1520)},
    {"format": "SRGGB12_CSI2P", "unpacked": "SRGGB12", "bit_depth": 12, "size": (4056, 3040)},
]
SETTINGS = CameraSettings(image_wh=(32, 24), bits=12, exposure_s=0.01, gain=2.0, colour_gains=(2.0, 1.6))


@dataclass
class _Sensor:
    """What the fake cameras see and do; one for a test."""

    stream_format: str = "SRGGB12"
    """What the stream is after configuring."""
    late: int = 0  # frames after the start that still have the automatic's settings
    metadata: dict[str, Any] = field(default_factory=dict)  # overrides of every frame's metadata
    silent: bool = False
    cameras: int = 1
    now_ns: int = 0
    light: list[tuple[int, float]] = field(default_factory=lambda: [(0, 0.25)])  # (from when, fraction of full scale)
    opened: list["_FakePicamera2"] = field(default_factory=list)
    requests: int = 0
    released: int = 0

    def set_light(self, level: float) -> None:
        self.light.append((self.now_ns, level))


@dataclass
class _FakeRequest:
    sensor: _Sensor
    config: Mapping[str, Any]
    start_ns: int
    controls: Mapping[str, Any]

    def make_array(self, name: str) -> NDArray[np.uint8]:
        assert name == "raw"
        (width, height), pixels = self.config["size"], self.config["format"]
        number = [level for since, level in self.sensor.light if since <= self.start_ns][-1] * (WHITE - BLACK)
        red, blue = SETTINGS.colour_gains
        colours = {"R": number / red, "G": number, "B": number / blue}
        bits = int(pixels[5:7]) if pixels[5:7].isdigit() else 16
        raw = np.full((height, self.config["stride"] // 2), 0xFFFF, np.uint16)  # padding that must not be looked at
        for i, colour in enumerate(pixels[1:5] if pixels.startswith("S") else pixels[:4]):
            raw[i // 2 :: 2, i % 2 : width : 2] = (BLACK + round(colours[colour])) << (bits - 12)
        return raw.view(np.uint8)

    def get_metadata(self) -> dict[str, Any]:
        return {
            "SensorTimestamp": self.start_ns + 1000 * self.controls["ExposureTime"],
            "DigitalGain": 1.0051,
            "SensorBlackLevels": (4096, 4096, 4096, 4096),
            "ExposureTime": self.controls["ExposureTime"] - 6,  # whole rows
            "AnalogueGain": self.controls["AnalogueGain"],
            "ColourGains": self.controls["ColourGains"],
            **self.sensor.metadata,
        }

    def release(self) -> None:
        self.sensor.released += 1


class _FakePicamera2:
    sensor: _Sensor

    def __init__(self, number: int) -> None:
        if number >= self.sensor.cameras:
            error = RuntimeError("Camera __init__ sequence did not complete.")
            raise error from RuntimeError("Device or resource busy")
        self.camera_properties = {"Model": "imx477"}
        self.camera_controls = {"ExposureTime": (114, 674_191_602, None), "AnalogueGain": (1.0, 22.26, None)}
        self.sensor_modes = [
            {"format": "YUYV"},
            {"unpacked": "SRGGB10", "bit_depth": 10, "size": (64, 48)},
            {"unpacked": "SRGGB12", "bit_depth": 12, "size": (64, 48)},
            {"unpacked": "SRGGB12", "bit_depth": 12, "size": (32, 24)},
        ]
        self.started_with: dict[str, Any] | None = None
        self.cancelled = self.closed = False
        self._config: dict[str, Any] = {}
        self._first_frame = 0
        self.sensor.opened.append(self)

    def create_still_configuration(self, **config: Any) -> dict[str, Any]:
        return config

    def configure(self, config: dict[str, Any]) -> None:
        width, _ = config["raw"]["size"]
        self._config = config | {"raw": config["raw"] | {"format": self.sensor.stream_format, "stride": 2 * width + 32}}

    def camera_configuration(self) -> dict[str, Any]:
        return self._config

    def start(self) -> None:
        self.started_with = dict(self._config["controls"])
        self._first_frame = self.sensor.now_ns // FRAME_NS

    def capture_request(self, *, wait: float, flush: bool) -> _FakeRequest:
        """Return a frame that is there already, or, flushed, the first whose exposure begins from now on."""
        assert self.started_with is not None
        assert not self.closed
        assert wait > 2 * self.started_with["ExposureTime"] / 1e6
        if self.sensor.silent:
            raise TimeoutError
        self.sensor.requests += 1
        index = -(-self.sensor.now_ns // FRAME_NS) if flush else max(self.sensor.now_ns // FRAME_NS - 1, self._first_frame)
        self.sensor.now_ns = max(self.sensor.now_ns, (index + 1) * FRAME_NS)
        late = index - self._first_frame < self.sensor.late
        return _FakeRequest(self.sensor, self._config["raw"], index * FRAME_NS, AUTOMATIC if late else self.started_with)

    def cancel_all_and_flush(self) -> None:
        self.cancelled = True

    def close(self) -> None:
        self.closed = True


@pytest.fixture
def sensor(monkeypatch: pytest.MonkeyPatch) -> _Sensor:
    found = _Sensor()
    module = ModuleType("picamera2")
    module.Picamera2 = type("Picamera2", (_FakePicamera2,), {"sensor": found})
    monkeypatch.setitem(sys.modules, "picamera2", module)
    return found


def opened(settings: CameraSettings = SETTINGS) -> PiCamera:
    camera = PiCamera("0", settings)
    camera.prepare()
    return camera


@pytest.mark.parametrize("stream_format", ["SRGGB12", "SGBRG12", "SRGGB16"])
def test_grey_is_linear_and_left_aligned_in_every_format(sensor: _Sensor, stream_format: str) -> None:
    sensor.stream_format = stream_format
    camera, images = opened(), []
    for level in (0.2, 0.8):
        sensor.set_light(level)
        images.append(camera.capture().image)
    taken = np.stack(images)
    assert (taken.dtype, taken.shape) == (np.uint16, (2, 24, 32))
    assert not np.ptp(taken, axis=(1, 2)).any()
    assert not (taken % 16).any()
    assert taken[:, 0, 0] / 65520 == pytest.approx([0.2, 0.8], abs=1.5 / 4095)


def test_settings_before_the_start_and_exposure_after_the_call(sensor: _Sensor) -> None:
    sensor.metadata["AnalogueGain"] = 2.01
    camera = opened()
    shot = camera.capture()
    assert (shot.exposure_s, shot.gain) == (pytest.approx(0.009994), 2.01)  # what the frame itself says
    assert sensor.opened[-1].started_with == {
        "AeEnable": False,
        "AwbEnable": False,
        "ExposureTime": 10000,
        "AnalogueGain": 2.0,
        "ColourGains": (2.0, 1.6),
        "FrameDurationLimits": (100, 1_000_000_000),
    }
    sensor.now_ns += FRAME_NS * 3 + FRAME_NS // 2  # frames pile up while the table turns
    sensor.set_light(0.75)
    assert camera.capture().image[0, 0] / 65520 == pytest.approx(0.75, abs=1e-3)


def test_frames_with_old_settings_are_passed_over_a_while(sensor: _Sensor) -> None:
    sensor.late = TRIES - 1
    opened()
    assert sensor.requests == sensor.released == TRIES
    sensor.late = 10**6
    with pytest.raises(RigError, match=r"ExposureTime is 19994 instead of 10000, AnalogueGain is 4 instead of 2, ColourGains red is 1.3"):
        opened()
    assert sensor.released == sensor.requests == 2 * TRIES


WRONG_METADATA = [
    ("DigitalGain", 1.3, "DigitalGain is 1.3 instead of 1"),
    ("ColourGains", None, "ColourGains red is missing"),
    ("SensorBlackLevels", None, "does not report its black level"),
    ("SensorTimestamp", 1000 * 10000, "the frame is the same as before"),  # that of the first frame
]


@pytest.mark.parametrize(("key", "value", "said"), WRONG_METADATA)
def test_wrong_metadata_refuse_a_picture(sensor: _Sensor, key: str, value: object, said: str) -> None:
    camera = opened()
    sensor.metadata[key] = value
    with pytest.raises(RigError, match=said):
        camera.capture()


def test_a_camera_that_stops_is_closed_and_can_be_opened_again(sensor: _Sensor) -> None:
    camera = opened()
    sensor.silent = True
    with pytest.raises(RigError, match="camera 0: the camera no longer delivers frames"):
        camera.capture()
    assert sensor.opened[-1].cancelled
    assert sensor.opened[-1].closed
    sensor.silent = False
    camera.prepare()
    assert camera.capture().image.shape == (24, 32)
    camera.close()
    assert sensor.opened[-1].closed
    with pytest.raises(RigError, match="not open"):
        camera.capture()


def test_no_camera_and_compressed_pixels_are_refused(sensor: _Sensor) -> None:
    sensor.stream_format = "RGGB_PISP_COMP1"
    with pytest.raises(RigError, match="delivers raw pixels as RGGB_PISP_COMP1 64x48, but only SRGGB12 64x48"):
        opened()
    sensor.cameras = 0
    with pytest.raises(RigError, match=r"did not complete: Device or resource busy\); look for it with rpicam-hello"):
        opened()


IMPOSSIBLE = [
    (CameraSettings(image_wh=(32, 24), exposure_s=1e-5), "ExposureTime 10 us is outside the sensor's range, 114 to 6.74192e"),
    (CameraSettings(image_wh=(30, 24)), "cannot take pictures of 30x24 pixels; available sizes: 32x24, 16x12"),
]


@pytest.mark.parametrize(("settings", "said"), IMPOSSIBLE)
def test_what_the_sensor_cannot_is_refused_before_the_start(sensor: _Sensor, settings: CameraSettings, said: str) -> None:
    with pytest.raises(RigError, match=said):
        opened(settings)
    assert sensor.opened[-1].started_with is None
    assert sensor.opened[-1].closed


def test_the_finest_mode_of_the_hq_camera_is_taken() -> None:
    modes = [choose_mode(IMX477, image_wh, name="camera 0") for image_wh in ((2028, 1520), (1014, 760), (1014, 540))]
    assert [(mode.size, mode.block) for mode in modes] == [((4056, 3040), 2), ((4056, 3040), 4), ((2028, 1080), 2)]


def test_without_picamera2(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "picamera2", None)
    with pytest.raises(RigError, match="sudo apt install python3-picamera2"):
        open_camera(CameraPart(), image_wh=(32, 24), bits=12, clock=SystemClock())


def grey(raw: list[list[int]], **changes: Any) -> list[list[int]]:
    options: dict[str, Any] = {"order": "RGGB", "black": (256.0,) * 4, "white": 4095.0, "colour_gains": (2.0, 4.0), "block": 2, "bits": 12}
    return grey_from_bayer(np.array(raw, np.uint16), **options | changes).tolist()


def test_blocks_by_hand() -> None:
    # (2 * 500 + 1000 + 1100 + 4 * 250) / 4 = 1025 of 3839 -> 1093.35 of 4095, four bits up
    for bits, value in ((12, 1093 << 4), (8, 68), (16, 17498)):  # 1025 / 3839 * 255 = 68.08, * 65535 = 17497.6
        assert grey([[756, 1256], [1356, 506]], bits=bits) == [[value]]
    # white 4096: gains 1; R 110-100, Gr 230-200, Gb 340-300, B 480-400, each of its own range
    light = (10 / 3996 + 30 / 3896 + 40 / 3796 + 80 / 3696) / 4
    options = {"black": (100.0, 200.0, 300.0, 400.0), "white": 4096.0, "colour_gains": (1.0, 1.0), "bits": 16}
    assert grey([[480, 340], [230, 110]], order="BGGR", **options) == [[round(light * 65535)]]
    assert grey([[200, 250, 256, 4095], [256, 255, 256, 256]]) == [[0, 65520]]  # below black is black, a full pixel fills its block
    raw = np.full((4, 4), 256)
    raw[:2, :2] += [[500, 1000], [1000, 250]]
    assert grey(raw.tolist(), block=4) == [[round(250 / 3839 * 4095) << 4]]
