"""System camera on USB (Canon, Nikon, Sony, Fujifilm ...), controlled with libgphoto2 through python-gphoto2.

Exposure, sensitivity, focus, white balance and file format are set, read back, and verified again after each picture,
also with the data in the raw file. libgphoto2 reports no error for some values that a camera does not have, but then
sets another one. The shutter is released over USB, or by the rig's board through the camera's shutter input.
"""

import importlib
import locale
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from rhizotwin.rig.cameras.gphoto_locks import Lock, locks_for, read_widget
from rhizotwin.rig.cameras.raw_files import open_raw
from rhizotwin.rig.cameras.settings import CameraSettings, check_picture
from rhizotwin.rig.clock import Clock
from rhizotwin.rig.devices import Shot
from rhizotwin.rig.errors import RigError
from rhizotwin.scenes.errors import UserError, pip_install
from rhizotwin.scenes.picture_codec import Grey, decode_grey

PATIENCE_S = 20.0
"""Maximum time from the release of the shutter until the file arrives, in addition to the exposure, s. It is the
timeout of libgphoto2's own capture (USB_TIMEOUT_CAPTURE in camlibs/ptp2)."""
EVENT_MS = 200
"""Time for which one call waits for an event of the camera, ms."""
APPLIED_S = 2.0
"""Maximum time until a setting reads as it was set, s. Some cameras step through their values."""
POLL_S = 0.1
NOMINAL = 0.10
"""Relative tolerance of exposure time and sensitivity. Cameras state rounded values: 1/60 s for 1/64 s, 30 s for 32 s.
Neighbouring values differ by 26 % (thirds of a stop)."""


class GphotoCamera:
    """Camera controlled with libgphoto2, with all automatic functions off."""

    def __init__(self, address: str, settings: CameraSettings, *, clock: Clock, on_board: bool = False, library: Any = None) -> None:
        """Import python-gphoto2. The camera is opened by `prepare`.

        Parameters
        ----------
        address : str
            Number of the camera (0: the first), or its port, such as usb:001,004.
        settings : CameraSettings
            Required settings.
        clock : Clock
            Clock for waiting times.
        on_board : bool
            Whether the rig's board releases the shutter, by the attribute ``shutter``.
        library : module or None
            Replacement of the module ``gphoto2``.

        Raises
        ------
        RigError
            If python-gphoto2 cannot be imported, or the address is invalid.
        """
        if not (address.isascii() and address.isdigit()) and ":" not in address:
            raise RigError(f"camera: address {address!r} is neither the number of a camera nor a port of libgphoto2 such as usb:001,004")
        self._address = address
        self._name = f"camera {address}"
        self._settings = settings
        self._clock = clock
        self._on_board = on_board
        self._library = _load(self._name) if library is None else library
        self._camera: Any = None
        self._model = ""
        self._locks: tuple[Lock, ...] = ()
        self.shutter: Callable[[], None] | None = None
        """Function that releases the shutter through the board. It is set by `rig.open.connect_shutter`."""

    def describe(self) -> str:
        """Return a description of the camera and its settings."""
        if self._camera is None:
            return f"gphoto2 {self._name}, not open"
        (width, height), settings = self._settings.image_wh, self._settings
        files = "raw files" if settings.linear else "JPEG files, whose response curve is that of the scene"
        by = "board" if self._on_board else "computer"
        exposure = f"{1000.0 * settings.exposure_s:g} ms, ISO {100.0 * settings.gain:g}"
        return f"{self._model} ({self._name}), {width}x{height} from {files}, {exposure}, shutter released by the {by}"

    def prepare(self) -> None:
        """Open the camera, set and verify its settings, and verify them with a picture."""
        self.close()
        if not self._settings.linear and self._settings.bits != 8:
            raise RigError(f"{self._name}: JPEG files have 8 bits, not {self._settings.bits}; set bits = 8 in the scene's [camera]")
        try:
            self._guard("opened", self._open)
            self.capture()
        except RigError:
            self.close()
            raise

    def capture(self) -> Shot:
        """Take a picture whose exposure begins after this call."""
        if self._camera is None:
            raise RigError(f"{self._name}: the camera is not open; open it first")
        data = self._guard("triggered", self._take)
        self._guard("read", self._check_locks)
        try:
            return self._shot(data)
        except RigError:
            raise
        except UserError as error:
            raise RigError(str(error)) from error

    def close(self) -> None:
        """Release the camera for other programs."""
        camera, self._camera = self._camera, None
        if camera is not None:
            with suppress(self._library.GPhoto2Error):
                camera.exit()

    def _open(self) -> None:
        found = self._library.Camera.autodetect()
        ports = [(found.get_name(i), found.get_value(i)) for i in range(found.count())]
        chosen = [pair for i, pair in enumerate(ports) if self._address in (str(i), pair[1])]
        if not chosen:
            listed = ", ".join(f"{model} at {port}" for model, port in ports) or "none"
            raise RigError(f"{self._name}: there is no such camera (found: {listed}); switch it on, and check its cable and address")
        self._model, port = chosen[0]
        places = self._library.PortInfoList()
        places.load()
        camera = self._library.Camera()
        camera.set_port_info(places[places.lookup_path(port)])
        camera.init()
        self._camera = camera
        self._locks = locks_for(self._settings, tolerance=NOMINAL)
        for lock in self._locks:
            self._set(lock)
        self._locks = tuple(lock.hold(read_widget(self._library, camera, lock)) for lock in self._locks)
        self._check_locks()

    def _set(self, lock: Lock) -> None:
        """Set a value, unless it is already set, and wait until the camera has applied it."""
        widget = read_widget(self._library, self._camera, lock)
        wanted = None if widget is None or widget.get_readonly() else lock.better(widget)
        if wanted is None:
            return
        widget.set_value(wanted)
        self._camera.set_single_config(widget.get_name(), widget)
        until_s = self._clock.now_s() + APPLIED_S
        while self._clock.now_s() < until_s:
            now = read_widget(self._library, self._camera, lock)
            if now is not None and now.get_value() == wanted:
                return
            self._clock.sleep(POLL_S)

    def _check_locks(self) -> None:
        faults = [fault for lock in self._locks if (fault := lock.fault(read_widget(self._library, self._camera, lock)))]
        if faults:
            raise RigError(f"{self._name} ({self._model}): the settings cannot be fixed: {'; '.join(faults)}")

    def _take(self) -> bytes:
        library, camera = self._library, self._camera
        self._discard_old()
        if not self._on_board:
            path = camera.capture(library.GP_CAPTURE_IMAGE)
        elif self.shutter is None:
            raise RigError(f"{self._name}: the shutter is released by the board (trigger in the rig file), which is not open here")
        else:
            self.shutter()
            path = self._await_file()
        file = camera.file_get(path.folder, path.name, library.GP_FILE_TYPE_NORMAL)
        data = bytes(memoryview(file.get_data_and_size()))
        with suppress(library.GPhoto2Error):  # the memory of the camera must not fill up, but the picture is complete
            camera.file_delete(path.folder, path.name)
        return data

    def _discard_old(self) -> None:
        """Discard events of earlier pictures, such as one that was released by hand."""
        until_s = self._clock.now_s() + PATIENCE_S
        while self._clock.now_s() < until_s:
            if self._camera.wait_for_event(1)[0] == self._library.GP_EVENT_TIMEOUT:
                return

    def _await_file(self) -> Any:
        wait_s = self._settings.exposure_s + PATIENCE_S
        until_s = self._clock.now_s() + wait_s
        while self._clock.now_s() < until_s:
            kind, what = self._camera.wait_for_event(EVENT_MS)
            if kind == self._library.GP_EVENT_FILE_ADDED:
                return what
        raise RigError(
            f"{self._name}: no picture arrived within {wait_s:.3g} s after the board released the shutter; check the shutter cable, "
            "trigger_pin, and that the camera does not focus"
        )

    def _shot(self, data: bytes) -> Shot:
        settings, is_jpeg = self._settings, data.startswith(b"\xff\xd8")
        if is_jpeg and settings.linear:
            raise RigError(
                f"{self._name}: the file is a JPEG, which is not linear in light; set the camera to raw files, or measure its curve with "
                "rhizotwin calibrate transfer and paste it into the scene's [camera]"
            )
        if not is_jpeg and not settings.linear:
            raise RigError(f"{self._name}: the file is a raw file, which is linear in light; remove transfer from the scene's [camera]")
        if is_jpeg:
            image: Grey = decode_grey(data, where=self._name)
            check_picture(image, settings, name=self._name)
            return Shot(image=image, exposure_s=settings.exposure_s, gain=settings.gain)
        raw = open_raw(data, where=self._name)
        gain = None if raw.iso is None else raw.iso / 100.0
        for what, stated, wanted in (("exposure", raw.exposure_s, settings.exposure_s), ("ISO / 100", gain, settings.gain)):
            if stated is not None and abs(stated / wanted - 1.0) > NOMINAL:
                raise RigError(f"{self._name}: the {what} of the picture is {stated:g} instead of {wanted:g}; set the camera to M")
        image = raw.light(image_wh=settings.image_wh, gains=settings.colour_gains, bits=settings.bits, where=self._name)
        return Shot(image=image, exposure_s=raw.exposure_s or settings.exposure_s, gain=gain or settings.gain)

    def _guard(self, done: str, action: Callable[[], Any]) -> Any:
        """Call the library, and turn its errors into a sentence. The camera has to be opened again afterwards."""
        try:
            return action()
        except self._library.GPhoto2Error as error:
            self.close()
            raise RigError(
                f"{self._name}: the camera could not be {done} ({error}); switch it on, check its cable, end other programs that use it "
                "(file managers open cameras: gvfs-gphoto2-volume-monitor), and start the program again"
            ) from error


def _load(name: str) -> Any:
    if hasattr(locale, "LC_MESSAGES"):
        locale.setlocale(locale.LC_MESSAGES, "C")  # libgphoto2 translates even the values of settings
    try:
        return importlib.import_module("gphoto2")
    except ImportError as error:
        raise RigError(f"{name}: python-gphoto2 cannot be imported here ({error}); run: {pip_install('gphoto2')}") from error
