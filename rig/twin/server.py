"""Standalone twin that runs in real time.

It has serial ports that any program can open, an HTTP camera server, and a matching rig file.
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
from rhizotwin.scenes.picture_codec import Grey
from rhizotwin.scenes.schema import to_plain

Say = Callable[[str], None]
HELP = "faults (list the faults), where (show the true state), help, quit, or a fault such as: reset, or: reply_late table amount=3"


class TwinServer:
    """Twin that runs in real time, with its ports and camera server.

    Parameters
    ----------
    twin
        Twin to run, which no other code may use.
    folder
        Folder for the links to the ports.
    speed
        Speed of the twin relative to real time.
    camera_port
        Port of the camera server on this computer; 0 selects a free port.
    say
        Function that receives messages for the user.
    """

    def __init__(self, twin: Twin, folder: Path, *, speed: float = 1.0, camera_port: int = 0, say: Say = lambda _: None) -> None:
        self.twin = twin
        self._ports = PtyPorts(twin.lines, twin.clock, folder, speed=speed, opened=self._on_open)
        self._camera = CameraServer(self._open_camera(twin.rig.camera), port=camera_port, reopen=self._reopen, say=say)

    @property
    def rig(self) -> RigFile:
        """Rig file that contains the addresses of the ports and the camera of this twin."""
        rig, paths = self.twin.rig, self._ports.paths
        return replace(
            rig,
            turntable=replace(rig.turntable, port=str(paths["table"])),
            arm=None if rig.arm is None else replace(rig.arm, port=str(paths["arm"])),
            camera=replace(rig.camera, kind="http", address=self._camera.url),
        )

    def start(self) -> None:
        """Start to serve the ports and the camera."""
        self._ports.start()
        self._camera.start()

    def stop(self) -> None:
        """Close the camera server and the ports."""
        self._camera.stop()
        self._ports.stop()

    def inject(self, fault: Fault) -> None:
        """Add a fault to the running twin."""
        with self._ports.lock:
            self.twin.inject(fault)
        self._ports.wake()

    def where(self) -> str:
        """Return a text that describes the true state of the devices."""
        with self._ports.lock:
            self._ports.catch_up()
            world = self.twin.world
            joints = ", ".join(f"{angle:.2f}" for angle in world.joints_deg) or "no arm"
            lamps = f"panel {world.panel.level:.3f}, front light {world.front.level:.3f}"
            return f"true state: table {world.table_deg:.3f} deg; joints {joints} deg; {lamps}"

    def _on_open(self, name: str) -> None:
        if name == "table":
            self.twin.on_board_opened()

    def _reopen(self, settings: CameraSettings) -> Camera:
        return self._open_camera(replace(self.twin.rig.camera, exposure_s=settings.exposure_s, gain=settings.gain))

    def _open_camera(self, part: CameraPart) -> Camera:
        return self.twin.open_camera(part, clock=self._ports.real, look=self._look)

    def _look(self, exposure: float) -> Grey:
        """Render a picture of the present state of the world, while the ports remain in operation."""
        with self._ports.lock:
            self._ports.catch_up()
            sight = self.twin.world.sight(exposure=exposure)
        return self.twin.paint(sight)


def rig_text(rig: RigFile) -> str:
    """Format a rig as the text of a rig file.

    If `rig.rig_file.load_rig` reads the text, the result equals the rig.
    """
    return toml_text.dumps(_without_none(to_plain(rig)))


def run_twin(twin: Twin, *, speed: float, write_rig: Path | None, say: Say, camera_port: int = 0, commands: int | None = None) -> None:
    """Run a twin until the user enters the command quit, or an exception such as KeyboardInterrupt is raised.

    Parameters
    ----------
    twin : Twin
        Twin to run, which no other code may use.
    speed : float
        Speed of the twin relative to real time.
    write_rig : path or None
        Path of the rig file to write. The scene as known to a laboratory is written beside it (``NAME_scene.toml``).
        None to write neither file.
    say : Say
        Function that receives messages for the user.
    camera_port : int
        Port of the camera's HTTP server on this computer; 0 selects a free port.
    commands : int or None
        File descriptor for commands of the user; None for stdin.

    Raises
    ------
    UserError
        If a file cannot be written.
    """
    if speed <= 0.0:
        raise UserError(f"speed {speed:g} is invalid; it must be positive (1 is real time)")
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
                say(f"rig file: {write_rig}; scene with the calibrated lens: {scene_path}")
            server.start()
            say(f"the twin is running at {speed:g} times real time; press Ctrl-C to stop. Commands: {HELP}")
            for word in _lines(_console_descriptor() if commands is None else commands):
                if word == "quit":
                    break
                say(_answer(server, word))
        finally:
            server.stop()


def _console_descriptor() -> int | None:
    """Return the file descriptor of stdin.

    The result is None if there is no stdin, or if another program in the foreground uses it.
    """
    try:
        descriptor = sys.stdin.fileno()
        behind = os.isatty(descriptor) and os.tcgetpgrp(descriptor) != os.getpgrp()
    except (AttributeError, OSError, ValueError):
        return None
    return None if behind else descriptor


def _lines(descriptor: int | None) -> Iterator[str]:
    """Yield each line that the user types.

    After the end of the input, wait for Ctrl-C.
    """
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
    return f"fault {fault.kind} was added to the {fault.device}"


def _without_none(value: Any) -> Any:
    """Remove all entries that are None, which TOML does not support. They occur only for a rig without an arm."""
    return {key: _without_none(item) for key, item in value.items() if item is not None} if isinstance(value, dict) else value
