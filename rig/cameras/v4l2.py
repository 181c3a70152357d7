"""USB camera, controlled with OpenCV and Video4Linux.

A driver may report settings that it has not applied. Therefore all settings are read back after they are set, after the
second frame, and after each picture. Pictures have 8 bits. They are linear in light only if the camera's gamma can be
set to 1; `describe` reports whether it can.
"""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from rhizotwin.rig.cameras.settings import CameraSettings, check_picture
from rhizotwin.rig.devices import Shot
from rhizotwin.rig.errors import RigError
from rhizotwin.scenes.picture_codec import Grey

UNIT_S = 1e-4
"""Unit of the absolute exposure time in V4L2, s."""
MANUAL = 1
"""Value of V4L2_EXPOSURE_MANUAL."""
LINEAR_GAMMA = 100
"""Value of the gamma control that corresponds to a gamma of 1, in units of the USB video class (gamma times 100)."""
STALE = 5
"""Number of frames that may have been exposed before a call: four in the buffers of OpenCV, and one in the sensor."""
WARM_UP = 10
"""Number of frames after which new settings have taken effect."""
ABSENT = -1.0
"""Value that OpenCV returns for a control that the camera does not have."""


@dataclass(frozen=True, kw_only=True)
class Control:
    """Control of the camera and its required value."""

    name: str
    prop: int
    value: float
    tolerance: float = 0.5
    needed: bool = False
    """Whether the camera is rejected if it does not have this control."""


class V4l2Camera:
    """USB camera with fixed settings, accessed through cv2.VideoCapture."""

    def __init__(self, address: str, settings: CameraSettings) -> None:
        """Check the address. The camera is opened by `prepare`.

        Raises
        ------
        RigError
            If the address is neither a number nor a device file.
        """
        is_number = address.isascii() and address.isdigit()
        if not is_number and not address.startswith("/dev/"):
            raise RigError(f"camera: address {address!r} is neither a number nor a device file such as /dev/video0")
        self._source: int | str = int(address) if is_number else address
        self._name = f"camera /dev/video{address}" if is_number else f"camera {address}"
        self._settings = settings
        self._controls = _controls(settings)
        self._capture: Any = None
        self._gamma = ABSENT

    def describe(self) -> str:
        """Return a description of the camera that includes whether its pictures are linear in light."""
        if self._capture is None:
            return f"USB {self._name}, not open"
        width, height = self._settings.image_wh
        format_name = (
            int(self._capture.get(cv2.CAP_PROP_FOURCC)).to_bytes(4, "little", signed=False).decode("ascii", "replace").strip("\0 ")
        )
        linear = "" if self._gamma == LINEAR_GAMMA else "; the gamma cannot be set to 1, so that the pictures may not be linear in light"
        return f"USB {self._name}, {width}x{height}, 8 bits, {format_name}, {1000.0 * self._settings.exposure_s:g} ms{linear}"

    def prepare(self) -> None:
        """Open the camera, apply all settings, and verify them after the second frame."""
        self.close()
        if self._settings.bits != 8:
            raise RigError(
                f"{self._name}: a camera of kind v4l2 has 8 bits, not {self._settings.bits}; set bits = 8 in the scene's [camera]"
            )
        capture = cv2.VideoCapture(self._source, cv2.CAP_V4L2)
        if not capture.isOpened():
            capture.release()
            raise RigError(
                f"{self._name}: the camera cannot be opened; look for it with ls /dev/video*, check its cable and that you are in the "
                "group video, "
                "and stop other programs that use it (the Raspberry Pi's own camera has kind picamera2)"
            )
        self._capture = capture
        try:
            self._set_up()
            self._drop(WARM_UP)
            self._read()
            self._read()
            self._check_controls()
        except RigError:
            self.close()
            raise

    def capture(self) -> Shot:
        """Take a picture whose exposure begins after this call. Buffered frames are discarded."""
        if self._capture is None:
            raise RigError(f"{self._name}: the camera is not open; open it first")
        self._drop(STALE)
        image = self._read()
        self._check_controls()
        gain = float(self._capture.get(cv2.CAP_PROP_GAIN))
        exposure_s = UNIT_S * float(self._capture.get(cv2.CAP_PROP_EXPOSURE))
        return Shot(image=image, exposure_s=exposure_s, gain=None if gain == ABSENT else gain)

    def close(self) -> None:
        """Release the camera for other programs."""
        if self._capture is not None:
            self._capture.release()
            self._capture = None

    def _set_up(self) -> None:
        capture, (width, height) = self._capture, self._settings.image_wh
        # Format and size restart the stream, so they are set before the controls. The format is uncompressed, if
        # supported.
        capture.set(cv2.CAP_PROP_FOURCC, cv2.VideoWriter.fourcc(*"YUYV"))
        capture.set(cv2.CAP_PROP_FRAME_WIDTH, width)
        capture.set(cv2.CAP_PROP_FRAME_HEIGHT, height)
        capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)  # often ignored, hence `STALE`
        for control in self._controls:
            capture.set(control.prop, control.value)
        capture.set(cv2.CAP_PROP_GAMMA, LINEAR_GAMMA)
        self._gamma = float(capture.get(cv2.CAP_PROP_GAMMA))
        self._check_controls()

    def _check_controls(self) -> None:
        faults = []
        for control in self._controls:
            found = float(self._capture.get(control.prop))
            if abs(found - control.value) > control.tolerance and (control.needed or found != ABSENT):
                faults.append(f"{control.name} {'is missing' if found == ABSENT else f'is {found:g}'} instead of {control.value:g}")
        if faults:
            raise RigError(
                f"{self._name}: the settings were not applied: {', '.join(faults)}; list the camera's controls with v4l2-ctl --list-ctrls"
            )

    def _drop(self, frames: int) -> None:
        for _ in range(frames):
            if not self._capture.grab():
                raise self._silent()

    def _read(self) -> Grey:
        answered, frame = self._capture.read()
        if not answered or frame is None:
            raise self._silent()
        picture = np.asarray(cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY) if frame.ndim == 3 and frame.shape[2] == 3 else np.squeeze(frame))
        check_picture(picture, self._settings, name=self._name)
        return picture

    def _silent(self) -> RigError:
        return RigError(f"{self._name}: the camera no longer delivers pictures; check its cable")


def _controls(settings: CameraSettings) -> tuple[Control, ...]:
    """Return the controls in the order in which they must be set.

    Automatic functions are switched off before dependent values are set.
    """
    units = settings.exposure_s / UNIT_S
    return (
        Control(name="automatic exposure", prop=cv2.CAP_PROP_AUTO_EXPOSURE, value=MANUAL, needed=True),
        Control(name="exposure (in 0.1 ms)", prop=cv2.CAP_PROP_EXPOSURE, value=units, tolerance=max(0.5, 0.02 * units), needed=True),
        Control(name="gain", prop=cv2.CAP_PROP_GAIN, value=settings.gain, tolerance=0.5),
        Control(name="automatic white balance", prop=cv2.CAP_PROP_AUTO_WB, value=0),
        Control(name="white balance", prop=cv2.CAP_PROP_WB_TEMPERATURE, value=settings.white_balance_kelvin, tolerance=100.0),
        Control(name="autofocus", prop=cv2.CAP_PROP_AUTOFOCUS, value=0),
    )
