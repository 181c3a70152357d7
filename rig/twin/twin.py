"""Complete emulated rig that runs within this process, in virtual time."""

import itertools
import math
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Literal, Protocol

import serial

from rhizotwin.rig.cameras.gphoto import GphotoCamera
from rhizotwin.rig.cameras.settings import combine_settings
from rhizotwin.rig.clock import Clock
from rhizotwin.rig.rig_file import LSC_BAUD, ArmPart, BandPart, CameraPart, RigFile
from rhizotwin.rig.twin import protocol_twin
from rhizotwin.rig.twin import rendered_pictures as rendering
from rhizotwin.rig.twin.adapter import Adapter
from rhizotwin.rig.twin.camera import Look, TwinCamera
from rhizotwin.rig.twin.clock import VirtualClock
from rhizotwin.rig.twin.faults import Device, Fault, Pending
from rhizotwin.rig.twin.gphoto_library import EmulatedBody, EmulatedLibrary
from rhizotwin.rig.twin.imperfections import device_errors
from rhizotwin.rig.twin.line import Line
from rhizotwin.rig.twin.lsc_adapter import LscAdapter
from rhizotwin.rig.twin.lx_adapter import LxAdapter
from rhizotwin.rig.twin.marlin_adapter import MarlinAdapter
from rhizotwin.rig.twin.record import Record
from rhizotwin.rig.twin.sketch import Sketch
from rhizotwin.rig.twin.world import Sight, TwinWorld
from rhizotwin.scenes.dataset import Frame
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.picture_codec import Grey, decode_grey

PictureKind = Literal["render", "sketch"]
ArmProtocol = Literal["lx", "lsc"]
_NUMBERS = itertools.count(1)


class Painter(Protocol):
    """Interface of a renderer of the twin's pictures."""

    def picture(self, sight: Sight) -> Grey:
        """Return the picture (H, W) that the camera stores for a given state of the rig."""


class Twin:
    """Emulated rig with devices, world, camera and ports.

    Parameters
    ----------
    scene : Scene
        Scene with its specimen and disturbances. Disturbances of arm and table are replaced by the errors of the
        devices.
    seed : int
        Random seed of all errors and of the noise.
    profile_name : str
        Disturbance profile that defines the errors of the devices; ``clean`` has no errors.
    faults : iterable of Fault
        Faults to simulate.
    pictures : {"render", "sketch"}
        Kind of pictures: rendered by `sim` (the Mitsuba variant must have been selected), or drawn in milliseconds.
    rig : RigFile or None
        Rig file with the devices, whose ports are replaced by the ports of the twin. None for `default_rig`.
    resets_on_open : bool
        Whether opening the table's port resets the board, as it does on boards with a USB serial chip.
    samples : int or None
        Number of rays per pixel of rendered pictures; None for the default.
    """

    def __init__(
        self,
        scene: Scene,
        *,
        seed: int = 0,
        profile_name: str = "bench",
        faults: Iterable[Fault] = (),
        pictures: PictureKind = "render",
        rig: RigFile | None = None,
        resets_on_open: bool = False,
        samples: int | None = None,
    ) -> None:
        if seed < 0:
            raise UserError(f"seed {seed} is negative, but must be 0 or a positive integer")
        if protocol_twin.PACKAGE not in serial.protocol_handler_packages:
            serial.protocol_handler_packages.append(protocol_twin.PACKAGE)
        self.scene = scene
        self.seed = seed
        self.rig = _with_ports(rig or default_rig(scene=scene), f"twin://{next(_NUMBERS)}")
        self.clock = VirtualClock()
        self.pending = Pending(tuple(faults))
        self.record = Record()
        drawn = rendering.draw(scene, seed=seed)
        self._ring_cameras = drawn.ring_cameras
        self.world = TwinWorld(
            scene, self.rig, seed=seed, imperfections=device_errors(profile_name), table_from_canister=drawn.table_from_canister
        )
        self.put_camera(0)
        self._rendered = rendering.RenderedPictures(scene, seed=seed, samples=samples) if pictures == "render" else None
        self._painter: Painter = self._rendered or Sketch(scene, distortion=drawn.distortion, canister_from_strip=drawn.canister_from_strip)
        self.board = MarlinAdapter(self.world.table, (self.world.lamp(0), self.world.lamp(1)), outputs_on=self.world.outputs_on)
        self._resets_on_open = resets_on_open
        self._later: list[tuple[float, Callable[[], None]]] = []
        self._was_s = 0.0
        self.clock.add(self)
        self.lines = {"table": self._line("table", self.board, self.rig.turntable.baud)}
        if self.rig.arm is not None:
            adapter: Adapter = (LscAdapter if self.rig.arm.protocol == "lsc" else LxAdapter)(self.world.servos, self.world.supply)
            self.lines["arm"] = self._line("arm", adapter, self.rig.arm.baud)
        self._sockets = []
        for (name, line), url in zip(self.lines.items(), self._urls(), strict=True):
            self.clock.add(line)
            socket = protocol_twin.Socket(line, self.clock, self.on_board_opened if name == "table" else _do_nothing)
            protocol_twin.register(url, socket)
            self._sockets.append(socket)

    def open_camera(
        self, part: CameraPart | None = None, *, clock: Clock | None = None, look: Look | None = None
    ) -> TwinCamera | GphotoCamera:
        """Create a driver of the twin's camera.

        Parameters
        ----------
        part : CameraPart or None
            Settings of the camera; None for the settings of the rig file, which result in the scene's nominal
            brightness.
        clock, look : Clock or None, Look or None
            Clock of exposures, and function that takes pictures, for a twin in real time.

        Returns
        -------
        TwinCamera or GphotoCamera
            Driver of the camera, not yet open. If the kind is gphoto2, the library is emulated.
        """
        part, clock, nominal = part or self.rig.camera, clock or self.clock, self.rig.camera
        if part.kind != "gphoto2":
            return TwinCamera(look or self.look, clock, part=part, nominal=nominal, pending=self.pending)
        lens = self.scene.camera
        body = EmulatedBody(look=look or self.look, clock=clock, nominal_s=nominal.exposure_s * nominal.gain, bits=lens.bits)
        self.board.commands.shutter = body.release
        settings = combine_settings(part, image_wh=lens.image_wh, bits=lens.bits, linear=lens.transfer == "linear")
        return GphotoCamera(part.address, settings, clock=clock, on_board=part.trigger == "board", library=EmulatedLibrary(body))

    def look(self, exposure: float = 1.0) -> Grey:
        """Return the picture (H, W) that the camera stores for the present state of the rig, and record it."""
        return self.paint(self.world.sight(exposure=exposure))

    def paint(self, sight: Sight) -> Grey:
        """Return the picture (H, W) that the camera stores for a given state of the rig, and record it."""
        image = self._painter.picture(sight)
        self.record.add(image, sight, self.clock.now_s())
        return image

    def calibrated_scene(self) -> Scene:
        """Return the scene as it is known in a laboratory.

        It contains the nominal rig and the calibrated lens, but no specimen.
        """
        return rendering.calibrated_scene(self.scene)

    def put_camera(self, ring: int) -> None:
        """Move the tripod to the position of a ring.

        The position has the accuracy of manual placement. The method is only for rigs without an arm.
        """
        self.world.tripod_cam_from_rig = self._ring_cameras[ring]

    def write_truth(self, folder: Path | str, frames: Iterable[Frame]) -> bool:
        """Write the ``truth`` folder of a dataset that was taken with this twin.

        It contains the solid, the skeleton, the true poses and the masks.

        Returns
        -------
        bool
            Whether the truth was written. False for sketched pictures, and for a scene without a specimen.

        Raises
        ------
        UserError
            If a frame was taken neither by this twin nor by a twin whose record was loaded (`Record.keep_in`).
        """
        if self._rendered is None or not self.scene.is_planted:
            return False
        taken = []
        for frame in frames:
            path = Path(folder) / frame.file
            shot = self.record.shot_of(decode_grey(path.read_bytes(), where=str(path)))
            if shot is None:
                raise UserError(f"{path}: the picture was not taken by this emulated rig, so that its true pose is unknown")
            taken.append((frame.file, shot.sight))
        self._rendered.write_truth(Path(folder), taken)
        return True

    def inject(self, fault: Fault) -> None:
        """Add a fault to be simulated."""
        self.pending.add(fault)

    def break_device(self, fault: Fault) -> None:
        """Apply a fault of kind "device" immediately."""
        now_s = self.clock.now_s()
        self.pending.use(fault, now_s)
        until_s = now_s + fault.amount if fault.amount > 0.0 else math.inf
        if fault.kind == "reset":
            self._reset("Watchdog Reset")
        elif fault.kind == "stopped":
            self.board.commands.stopped = True
        elif fault.kind == "unplugged":
            self.lines[fault.device].unplug()
            self._later.append((until_s, self.lines[fault.device].plug))
        elif fault.kind == "brown_out":
            self.world.brown_out(fault.amount)
        elif self.rig.arm is not None:
            servo = self.world.servos[self.rig.arm.joints[fault.joint % len(self.rig.arm.joints)].servo]
            if fault.kind == "overheated":
                servo.heat(fault.amount)
            else:
                servo.stalled = True
                self._later.append((until_s, lambda: setattr(servo, "stalled", False)))

    def repair(self) -> None:
        """Prepare the rig as a user would before resuming an interrupted scan.

        All faults are removed, the arm is parked, and the board is reset if it has halted.
        """
        self.pending.clear()
        for line in self.lines.values():
            line.unplug()  # bytes in transmission are lost
            line.plug()
        for _, action in self._later:
            action()
        self._later.clear()
        for servo in self.world.servos.values():
            servo.stalled = False
            servo.cool_down()
        self.world.brown_out(0.0)
        self.world.put_arm_to_rest()
        if self.board.halted or self.board.commands.stopped:
            self._reset("External Reset")

    def on_board_opened(self) -> None:
        """Reset the board if it resets whenever its port is opened."""
        if self._resets_on_open:
            self._reset("External Reset")

    def next_s(self) -> float:
        """Return the time at which the next fault begins or ends, s."""
        return min([self.pending.next_s(), *(at_s for at_s, _ in self._later)])

    def advance_to(self, now_s: float) -> None:
        """Advance the devices to the given time in seconds, then apply the faults that are due."""
        self.world.advance(now_s - self._was_s)
        self._was_s = now_s
        for name in self.lines:
            for fault in self.pending.due(self.lines[name].device, "device", -1, now_s):
                self.break_device(fault)
        due = [action for at_s, action in self._later if at_s <= now_s]
        self._later = [later for later in self._later if later[0] > now_s]
        for action in due:
            action()

    def _line(self, device: Device, adapter: Adapter, baud: int) -> Line:
        return Line(device, adapter, baud=baud, pending=self.pending, break_device=self.break_device)

    def _reset(self, reason: str) -> None:
        self.board.reset(self.clock.now_s(), reason=reason)
        self.lines["table"].silence()

    def _urls(self) -> list[str]:
        return [self.rig.turntable.port, *([self.rig.arm.port] if self.rig.arm is not None else [])]


def default_rig(protocol: ArmProtocol = "lx", *, scene: Scene | None = None) -> RigFile:
    """Return the default rig of a twin.

    Parameters
    ----------
    protocol : {"lx", "lsc"}
        Protocol of the servos of the arm.
    scene : Scene or None
        Scene that defines the bands. The first band with both lights on is white light. Each other band has a separate
        lamp.
    """
    arm = ArmPart(protocol="lsc", baud=LSC_BAUD) if protocol == "lsc" else ArmPart()
    names = [] if scene is None else [band.name for band in scene.camera.bands]
    main = next((name for name in names if scene is not None and scene.is_lit(name)), "")
    bands = tuple(
        BandPart(name=name) if name == main else BandPart(name=name, panel_level=0.0, front_level=0.0, output=number)
        for number, name in enumerate(names)
    )
    return RigFile(name="twin", description="an emulated rig", arm=arm, camera=CameraPart(bands=bands))


def _with_ports(rig: RigFile, base: str) -> RigFile:
    table = replace(rig.turntable, port=f"{base}/table")
    return replace(rig, turntable=table, arm=None if rig.arm is None else replace(rig.arm, port=f"{base}/arm"))


def _do_nothing() -> None:
    """Do nothing when a port is opened."""
