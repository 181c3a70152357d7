"""Standalone emulated rig in real time.

It provides serial ports for any program, a camera over HTTP, and a rig file with their addresses.
"""

import os
import select
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from rhizotwin.rig.cameras.server import CameraServer
from rhizotwin.rig.cameras.settings import CameraSettings
from rhizotwin.rig.devices import Camera
from rhizotwin.rig.rig_file import CameraPart, RigFile
from rhizotwin.rig.twin.faults import MENU, Fault, parse_fault
from rhizotwin.rig.twin.pty_ports import PtyPorts
from rhizotwin.rig.twin.twin import Twin
from rhizotwin.scenes import toml_text
from rhizotwin.scenes.atomic import write_text
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.files import save_scene
from rhizotwin.scenes.pictures import Grey
from rhizotwin.scenes.schema import to_plain

Say = Callable[[str], None]
HELP = "a fault (such as: reset, or: reply_late table amount=3), faults, where, help, quit"


class TwinServer:
    """A twin with its ports and its camera server.

    Parameters
    ----------
    twin
        Nothing else may use it meanwhile.
    folder
        Gets the ports' links.
    speed
        How much faster than real its time passes.
    camera_port
        Of the camera server on this computer; 0 takes a free one.
    say
        Gets lines for people.
    """

    def __init__(self, twin: Twin, folder: Path, *, speed: float = 1.0, camera_port: int = 0, say: Say = lambda _: None) -> None:
        self.twin = twin
        self._ports = PtyPorts(twin.lines, twin.clock, folder, speed=speed, opened=self._opened)
        self._camera = CameraServer(self._camera_of(twin.rig.camera), port=camera_port, reopen=self._reopen, say=say)

    @property
    def rig(self) -> RigFile:
        """The rig file that leads here."""
        rig, paths = self.twin.rig, self._ports.paths
        return replace(
            rig,
            turntable=replace(rig.turntable, port=str(paths["table"])),
            arm=None if rig.arm is None else replace(rig.arm, port=str(paths["arm"])),
            camera=replace(rig.camera, kind="http", address=self._camera.url),
        )

    def start(self) -> None:
        """Begin to answer."""
        self._ports.start()
        self._camera.start()

    def stop(self) -> None:
        """Close everything."""
        self._camera.stop()
        self._ports.stop()

    def inject(self, fault: Fault) -> None:
        """Trigger a fault."""
        with self._ports.lock:
            self.twin.inject(fault)
        self._ports.wake()

    def where(self) -> str:
        """Describe the true state of the devices."""
        with self._ports.lock:
            self._ports.catch_up()
            world = self.twin.world
            joints = ", ".join(f"{angle:.2f}" for angle in world.joints_deg) or "no arm"
            lamps = f"panel {world.panel.level:.3f}, front light {world.front.level:.3f}"
            return f"true state: table {world.table_deg:.3f} deg; joints {joints} deg; {lamps}"

    def _opened(self, name: str) -> None:
        if name == "table":
            self.twin.board_opened()

    def _reopen(self, settings: CameraSettings) -> Camera:
        return self._camera_of(replace(self.twin.rig.camera, exposure_s=settings.exposure_s, gain=settings.gain))

    def _camera_of(self, part: CameraPart) -> Camera:
        return self.twin.open_camera(part, clock=self._ports.real, look=self._look)

    def _look(self, exposure: float) -> Grey:
        """Read the state of the world, and render it without blocking the ports."""
        with self._ports.lock:
            self._ports.catch_up()
            sight = self.twin.world.sight(exposure=exposure)
        return self.twin.paint(sight)


def rig_text(rig: RigFile) -> str:
    """Return a rig file's text, which `rig.rig_file.load_rig` reads back to an equal rig."""
    return toml_text.dumps(_without_none(to_plain(rig)))


def run_twin(twin: Twin, *, speed: float, write_rig: Path | None, say: Say, camera_port: int = 0, commands: int | None = None) -> None:
    """Run a twin until Ctrl-C (an exception) or the command quit.

    Parameters
    ----------
    twin : Twin
        Nothing else may use it meanwhile.
    speed : float
        How much faster than real its time passes.
    write_rig : path or None
        Where the rig file goes, with the scene as a lab would know it beside it (``NAME_scene.toml``); None: neither is
        written.
    say : Say
        Gets lines for people.
    camera_port : int
        Of the camera's HTTP server on this computer; 0 takes a free one.
    commands : int or None
        Descriptor that console lines are read from; None: stdin's.

    Raises
    ------
    UserError
        When a file cannot be written.
    """
    if speed <= 0.0:
        raise UserError(f"speed {speed:g} must be positive; 1 is real time")
    with tempfile.TemporaryDirectory(prefix="rhizotwin-") as folder:
        server = TwinServer(twin, Path(folder), speed=speed, camera_port=camera_port, say=say)
        try:
            rig = server.rig
            say(f"turntable and lights: {rig.turntable.port} (Marlin)")
            if rig.arm is not None:
                say(f"arm: {rig.arm.port} ({rig.arm.protocol} protocol)")
            say(f"camera: {rig.camera.address}")
            if write_rig is not None:
                scene_path = write_rig.with_name(f"{write_rig.stem}_scene.toml")
                write_text(write_rig, rig_text(rig), new=True)
                save_scene(twin.calibrated_scene(), scene_path, new=True)
                say(f"rig file: {write_rig}, scene with the calibrated lens: {scene_path}")
            server.start()
            say(f"running at {speed:g} times real time; press Ctrl-C to stop. Commands: {HELP}")
            for word in _lines(_typed_at() if commands is None else commands):
                if word == "quit":
                    break
                say(_answer(server, word))
        finally:
            server.stop()


def _typed_at() -> int | None:
    """Return stdin's descriptor, or None.

    None: there is none, or it belongs to a program in the foreground while this one is not.
    """
    try:
        descriptor = sys.stdin.fileno()
        behind = os.isatty(descriptor) and os.tcgetpgrp(descriptor) != os.getpgrp()
    except (AttributeError, OSError, ValueError):
        return None
    return None if behind else descriptor


def _lines(descriptor: int | None) -> Iterator[str]:
    """Give each line that is typed; when there are no more, wait for Ctrl-C."""
    buffer = b""
    while data := b"" if descriptor is None else os.read(descriptor, 4096):
        *lines, buffer = (buffer + data).split(b"\n")
        yield from (word for line in lines if (word := line.decode(errors="replace").strip()))
    while True:
        select.select([], [], [], 3600.0)


def _answer(server: TwinServer, word: str) -> str:
    if word == "where":
        return server.where()
    if word == "faults":
        return "\n".join(f"{kind.name} ({' or '.join(kind.devices)}): {kind.what}" for kind in MENU)
    if word in ("help", "?"):
        return HELP
    try:
        fault = parse_fault(word)
    except UserError as error:
        return str(error)
    server.inject(fault)
    return f"{fault.kind} on the {fault.device}"


def _without_none(value: Any) -> Any:
    """Drop None, which TOML does not have: only a rig without an arm has it."""
    return {key: _without_none(item) for key, item in value.items() if item is not None} if isinstance(value, dict) else value
