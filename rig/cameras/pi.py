"""Camera on this Raspberry Pi, controlled with picamera2, which is imported only when the camera is opened.

Pictures are computed from the sensor's raw values instead of the processed stream. The default processing (contrast
stretch, gamma, lens shading, noise reduction, sharpening) is neither linear nor constant between pictures. A linear
tuning file can avoid this but provides only 8 bits, which are too few for the dark marker strip beside a bright panel.
The raw values have 12 bits, are linear, and need no tuning file. Each block of 2x2 (or 4x4 ...) raw pixels becomes one
grey pixel (`rig.cameras.bayer`). Thus the 4056x3040 raw pixels of the HQ camera become 2028x1520 pixels, each with the
averaged noise of four raw pixels. Pixel values are left-aligned in 16 bits, and full scale corresponds to the
converter's range above the black level.
"""

import importlib
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

from rhizotwin.rig.cameras.pi_frames import RELATIVE, RawMode, choose_mode, grey_of_frame, metadata_faults
from rhizotwin.rig.cameras.settings import CameraSettings, check_picture
from rhizotwin.rig.devices import Shot
from rhizotwin.rig.errors import RigError

INSTALL = (
    "sudo apt install python3-picamera2, and a Python that can import it (the system's own, or a venv made with --system-site-packages)"
)
TRIES = 8
"""Maximum number of frames to wait until changed settings take effect. It exceeds the delay of a change, which is
`BUFFERS` + 4 frames."""
BUFFERS = 2
PATIENCE_S = 10.0
"""Maximum waiting time for a picture, in addition to the duration of a few exposures, s. If no picture arrives in this
time, the camera is considered to have stopped."""

_TROUBLE = (RuntimeError, OSError, ValueError, IndexError, KeyError, TypeError)


class PiCamera:
    """Raspberry Pi camera with all automatic functions off.

    The settings are verified with the metadata of each picture.
    """

    def __init__(self, address: str, settings: CameraSettings) -> None:
        """Import picamera2. The camera is opened by `prepare`.

        Raises
        ------
        RigError
            If picamera2 cannot be imported, or the address is not a camera number.
        """
        if not (address.isascii() and address.isdigit()):
            raise RigError(
                f"camera: address {address!r} is not a camera number; for kind picamera2 it is 0 for the first camera and 1 for the second"
            )
        self._number = int(address)
        self._name = f"camera {address}"
        self._settings = settings
        self._library = _picamera2(self._name)
        self._camera: Any = None
        self._mode: RawMode | None = None
        self._last_ns = -1

    def describe(self) -> str:
        """Return a description of the sensor and its readout mode."""
        if self._camera is None or self._mode is None:
            return f"Raspberry Pi {self._name}, not open"
        model = self._camera.camera_properties.get("Model", "unknown sensor")
        (width, height), mode, settings = self._settings.image_wh, self._mode, self._settings
        return (
            f"Raspberry Pi {self._name} ({model}), {width}x{height} of {mode.size[0]}x{mode.size[1]} raw pixels of {mode.bits} bits, "
            f"{1000.0 * settings.exposure_s:g} ms, gain {settings.gain:g}"
        )

    def prepare(self) -> None:
        """Open the camera with its settings, and verify them with a picture."""
        self.close()
        if not self._settings.linear:
            raise RigError(f"{self._name}: the pictures are linear in light; remove transfer from the scene's [camera]")
        try:
            self._open()
        except RigError:
            self.close()
            raise
        except _TROUBLE as error:
            self.close()
            raise RigError(
                f"{self._name}: the camera cannot be opened ({_reason(error)}); look for it with rpicam-hello --list-cameras, check its "
                "cable, and "
                "stop other programs that use it"
            ) from error
        self.capture()

    def capture(self) -> Shot:
        """Take a picture whose exposure begins after this call.

        Frames with different settings, and frames exposed before the call, are discarded.
        """
        if self._camera is None or self._mode is None:
            raise RigError(f"{self._name}: the camera is not open; open it first")
        faults: list[str] = []
        for _ in range(TRIES):
            raw, metadata = self._frame()
            faults = metadata_faults(metadata, self._settings)
            if int(metadata.get("SensorTimestamp", 0)) <= self._last_ns:
                faults.append("the frame is the same as before")
            if not faults:
                self._last_ns = int(metadata.get("SensorTimestamp", 0))
                stream = self._camera.camera_configuration()["raw"]
                image = grey_of_frame(raw, stream, metadata, mode=self._mode, settings=self._settings, name=self._name)
                check_picture(image, self._settings, name=self._name)
                return Shot(image=image, exposure_s=1e-6 * float(metadata["ExposureTime"]), gain=float(metadata["AnalogueGain"]))
        raise RigError(
            f"{self._name}: the settings were not applied within {TRIES} frames: {', '.join(faults)}; choose an exposure and a gain that "
            "the sensor supports"
        )

    def close(self) -> None:
        """Stop the camera and release it."""
        camera, self._camera, self._mode, self._last_ns = self._camera, None, None, -1
        if camera is not None:
            with suppress(*_TROUBLE):
                camera.close()

    def _open(self) -> None:
        settings = self._settings
        self._camera = camera = self._library.Picamera2(self._number)
        mode = choose_mode(camera.sensor_modes, settings.image_wh, name=self._name)
        camera.configure(
            camera.create_still_configuration(
                main={"size": (640, 480)},  # required, but not used
                raw={"size": mode.size, "format": mode.format},
                buffer_count=BUFFERS,
                queue=False,
                controls={
                    "AeEnable": False,
                    "AwbEnable": False,
                    "ExposureTime": round(1e6 * settings.exposure_s),
                    "AnalogueGain": settings.gain,
                    "ColourGains": settings.colour_gains,
                    "FrameDurationLimits": (100, 1_000_000_000),
                },
            )
        )
        _check_range(camera.camera_controls, "ExposureTime", 1e6 * settings.exposure_s, "us", self._name)
        _check_range(camera.camera_controls, "AnalogueGain", settings.gain, "", self._name)
        self._mode = mode
        camera.start()

    def _frame(self) -> tuple[Any, Mapping[str, Any]]:
        """Return the raw values and the metadata of one frame."""
        try:
            # discards waiting frames, and the frame whose exposure has begun
            request = self._camera.capture_request(wait=4.0 * self._settings.exposure_s + PATIENCE_S, flush=True)
            try:
                return request.make_array("raw"), request.get_metadata()
            finally:
                request.release()
        except TimeoutError as error:
            with suppress(*_TROUBLE):
                self._camera.cancel_all_and_flush()  # otherwise closing the camera blocks forever
            self.close()
            raise RigError(f"{self._name}: the camera no longer delivers frames; check its cable, and start the program again") from error
        except _TROUBLE as error:
            self.close()
            raise RigError(
                f"{self._name}: the camera failed to take a picture ({_reason(error)}); check its cable, and start the program again"
            ) from error


def _picamera2(name: str) -> Any:
    try:
        return importlib.import_module("picamera2")
    except ImportError as error:
        raise RigError(f"{name}: picamera2 cannot be imported here ({error}); on a Raspberry Pi: {INSTALL}") from error
    except (ValueError, AttributeError) as error:  # compiled for another version of numpy
        raise RigError(
            f"{name}: picamera2 is incompatible with the installed numpy ({error}); use Raspberry Pi OS of Debian 13 or newer, and its own "
            "python3-numpy"
        ) from error


def _check_range(controls: Mapping[str, Any], key: str, value: float, unit: str, name: str) -> None:
    """Raise an error if a value is outside the sensor's range. An upper limit of 0 means that there is no limit."""
    low, high = controls[key][:2]
    if value < low * (1.0 - RELATIVE) or (high > low and value > high * (1.0 + RELATIVE)):
        raise RigError(
            f"{name}: {key} {value:g} {unit}".rstrip() + f" is outside the sensor's range, {low:g} to {high:g}; change the rig file"
        )


def _reason(error: BaseException) -> str:
    """Return the text of an error together with that of its cause.

    picamera2 replaces the messages of libcamera by its own.
    """
    texts = []
    at: BaseException | None = error
    while at is not None:
        texts.append(str(at).rstrip(".") or type(at).__name__)
        at = at.__cause__
    return ": ".join(texts)
