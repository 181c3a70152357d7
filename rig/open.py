"""Opening of the devices described in a rig file."""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

from rhizotwin.rig.arm.arm import open_arm as arm_on
from rhizotwin.rig.cameras import open_camera
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
    """The open devices of a rig."""

    rig: RigFile
    clock: Clock
    table: Turntable
    lights: Lights
    camera: Camera
    arm: Arm | None
    open_board: Callable[[], tuple[Turntable, Lights]]
    """Function that reopens the board of table and lights after it was lost."""

    def reconnect_board(self) -> None:
        """Close table and lights, and reopen them."""
        with suppress(RigError):
            self.table.close()
        self.table, self.lights = self.open_board()

    def close(self) -> None:
        """Close every device; errors of one do not prevent the others from being closed."""
        for device in (self.camera, self.arm, self.table):
            with suppress(RigError):
                if device is not None:
                    device.close()


def open_devices(rig: RigFile, scene: Scene, *, clock: Clock, camera: Camera | None = None, recorder: Recorder | None = None) -> Devices:
    """Open the devices of a rig, without any motion, light or current.

    Parameters
    ----------
    rig : RigFile
        Rig file with the devices.
    scene : Scene
        Scene, whose camera defines size and bit depth of the pictures.
    clock : Clock
        Clock for waiting times.
    camera : Camera or None
        Camera of the twin; None for that of the rig file.
    recorder : Recorder or None
        Records every transmitted byte.

    Returns
    -------
    Devices
        Devices, which the caller must close.

    Raises
    ------
    RigError
        If a device is missing; those opened before it are closed.
    """

    def board() -> tuple[Turntable, Lights]:
        return open_board(rig, clock=clock, recorder=recorder)

    table, lights = board()
    opened: list[Turntable | Arm] = [table]
    try:
        arm = open_arm(rig, clock=clock, recorder=recorder)
        opened += [] if arm is None else [arm]
        lens = scene.camera
        eye = open_camera(rig.camera, image_wh=lens.image_wh, bits=lens.bits, clock=clock) if camera is None else camera
    except BaseException:
        for device in opened:
            with suppress(RigError):
                device.close()
        raise
    return Devices(rig=rig, clock=clock, table=table, lights=lights, camera=eye, arm=arm, open_board=board)


def open_board(rig: RigFile, *, clock: Clock, recorder: Recorder | None = None) -> tuple[Turntable, Lights]:
    """Open the driver of table and lights: a Marlin board, or this Raspberry Pi's own pins.

    Parameters
    ----------
    rig : RigFile
        Rig file with the devices.
    clock : Clock
        Clock for waiting times.
    recorder : Recorder or None
        Records every transmitted byte.

    Returns
    -------
    Turntable, Lights
        Open devices; nothing was sent.
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
    """Open the arm's port; return None for a rig without an arm.

    Parameters
    ----------
    rig : RigFile
        Rig file with the devices.
    clock : Clock
        Clock for waiting times.
    recorder : Recorder or None
        Records every transmitted byte.

    Returns
    -------
    Arm or None
        Open arm; nothing was sent.
    """
    part = rig.arm
    if part is None:
        return None
    return arm_on(Port(part.port, baud=part.baud, clock=clock, device="arm", recorder=recorder), part, clock)
