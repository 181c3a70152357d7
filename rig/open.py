"""Creation of the device drivers described in a rig file."""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

from rhizotwin.rig.arm.arm import open_arm as arm_on
from rhizotwin.rig.cameras import open_camera
from rhizotwin.rig.cameras.gphoto import GphotoCamera
from rhizotwin.rig.clock import Clock
from rhizotwin.rig.devices import Arm, Camera, Lights, Turntable
from rhizotwin.rig.errors import RigError
from rhizotwin.rig.rig_file import RigFile
from rhizotwin.rig.serial_line.port import Port
from rhizotwin.rig.serial_line.recording import Recorder
from rhizotwin.rig.table.hat import HatLights, HatTurntable
from rhizotwin.rig.table.hat_pins import LgpioPins, Ws281xPixels
from rhizotwin.rig.table.lights import MarlinLights
from rhizotwin.rig.table.marlin import MarlinLink
from rhizotwin.rig.table.turntable import MarlinTurntable
from rhizotwin.scenes.model import Scene


@dataclass(kw_only=True)
class Devices:
    """Open devices of a rig."""

    rig: RigFile
    clock: Clock
    table: Turntable
    lights: Lights
    camera: Camera
    arm: Arm | None
    open_board: Callable[[], tuple[Turntable, Lights]]
    """Function that creates new drivers of the table and the lights, after the connection to their board was lost."""

    def reconnect_board(self) -> None:
        """Close the table and the lights, and reopen them."""
        with suppress(RigError):
            self.table.close()
        self.table, self.lights = self.open_board()

    def close(self) -> None:
        """Close every device. An error of one device does not prevent the other devices from being closed."""
        for device in (self.camera, self.arm, self.table):
            with suppress(RigError):
                if device is not None:
                    device.close()


def open_devices(rig: RigFile, scene: Scene, *, clock: Clock, camera: Camera | None = None, recorder: Recorder | None = None) -> Devices:
    """Open the devices of a rig, without causing any motion, light or current.

    Parameters
    ----------
    rig : RigFile
        Rig file with the devices.
    scene : Scene
        Scene whose camera defines size and bit depth of the pictures.
    clock : Clock
        Clock for waiting times.
    camera : Camera or None
        Camera of the twin; None for the camera of the rig file.
    recorder : Recorder or None
        Recorder of all transmitted bytes, if any.

    Returns
    -------
    Devices
        Open devices, which the caller must close.

    Raises
    ------
    RigError
        If a device is missing. All devices opened before are closed.
    """

    def board() -> tuple[Turntable, Lights]:
        return open_board(rig, clock=clock, recorder=recorder)

    table, lights = board()
    opened: list[Turntable | Arm] = [table]
    try:
        arm = open_arm(rig, clock=clock, recorder=recorder)
        opened += [] if arm is None else [arm]
        lens = scene.camera
        linear = lens.transfer == "linear"
        eye = open_camera(rig.camera, image_wh=lens.image_wh, bits=lens.bits, clock=clock, linear=linear) if camera is None else camera
    except BaseException:
        for device in opened:
            with suppress(RigError):
                device.close()
        raise
    devices = Devices(rig=rig, clock=clock, table=table, lights=lights, camera=eye, arm=arm, open_board=board)
    connect_shutter(eye, rig, lambda: devices.lights)
    return devices


def connect_shutter(camera: Camera, rig: RigFile, lights: Callable[[], Lights]) -> None:
    """Let the board release the shutter of a camera whose rig file says so.

    Parameters
    ----------
    camera : Camera
        Camera of the rig.
    rig : RigFile
        Rig file with the trigger.
    lights : callable
        Function that returns the present driver of the board's lamps.
    """
    if isinstance(camera, GphotoCamera):
        camera.shutter = lambda: lights().release_shutter(rig.camera.trigger_pin)


def open_board(rig: RigFile, *, clock: Clock, recorder: Recorder | None = None) -> tuple[Turntable, Lights]:
    """Create the drivers of the table and the lights.

    They are connected to a Marlin board, or to the pins of this Raspberry Pi.

    Parameters
    ----------
    rig : RigFile
        Rig file with the devices.
    clock : Clock
        Clock for waiting times.
    recorder : Recorder or None
        Recorder of all transmitted bytes, if any.

    Returns
    -------
    Turntable, Lights
        Open devices, to which nothing was sent yet.
    """
    part = rig.turntable
    if part.kind == "hat":
        hat = rig.hat
        pins = LgpioPins()
        try:
            pixels = Ws281xPixels((hat.panel_pin, hat.front_pin), (hat.panel_pixels, hat.front_pixels))
        except BaseException:
            pins.close()
            raise
        return HatTurntable(pins, hat, part, clock), HatLights(pixels, pins, rig.lights, clock, bands=rig.camera.bands)
    link = MarlinLink(Port(part.port, baud=part.baud, clock=clock, device="turntable", recorder=recorder))
    return MarlinTurntable(link, part, clock), MarlinLights(link, rig.lights, clock, bands=rig.camera.bands)


def open_arm(rig: RigFile, *, clock: Clock, recorder: Recorder | None = None) -> Arm | None:
    """Open the port of the arm and create its driver, or return None if the rig has no arm.

    Parameters
    ----------
    rig : RigFile
        Rig file with the devices.
    clock : Clock
        Clock for waiting times.
    recorder : Recorder or None
        Recorder of all transmitted bytes, if any.

    Returns
    -------
    Arm or None
        Open arm, to which nothing was sent yet.
    """
    part = rig.arm
    if part is None:
        return None
    return arm_on(Port(part.port, baud=part.baud, clock=clock, device="arm", recorder=recorder), part, clock)
