"""Actions of a person at the rig outside scans: commands, pictures, and check and release of the devices."""

from __future__ import annotations

import time
from datetime import datetime
from typing import TYPE_CHECKING

from rhizotwin.rig.bench import check
from rhizotwin.scenes.errors import UserError

if TYPE_CHECKING:
    from concurrent.futures import Future

    from rhizotwin.console.devices import DeviceStates
    from rhizotwin.console.rig_thread import RigThread
    from rhizotwin.console.scan_folders import ScanFolders
    from rhizotwin.steps.rigs import Bench

LIVE_S = 8.0
"""Time, in seconds, after which live pictures end if no client has requested the state."""
WORDS = ("table", "home", "lights", "band", "joint", "go", "look", "align", "park", "relax", "pose", "markers")
"""Commands of `rig.jog` that clients may execute. ``picture`` is excluded, because it writes a file to any path."""


class ByHand:
    """Runs the actions of a person in the thread of the rig.

    Parameters
    ----------
    rig, bench : RigThread, Bench
        Thread of the rig, and the rig with its scene.
    folders, devices : ScanFolders, DeviceStates
        Folders for pictures, and states of the devices that a check updates.
    """

    def __init__(self, rig: RigThread, bench: Bench, folders: ScanFolders, devices: DeviceStates) -> None:
        self._rig, self._bench, self._folders, self._devices = rig, bench, folders, devices

    def check_devices(self) -> Future[None]:
        """Check each device without moving the rig, as `rhizotwin rig check` does."""
        return self._rig.begin("check of the devices", self._check)

    def command(self, line: str) -> Future[list[str]]:
        """Execute a command of `rhizotwin rig jog`, and return its output lines.

        Raises
        ------
        UserError
            If the command is unknown or not permitted to clients, or the rig is busy.
        """
        words = line.split()
        if not words or words[0] not in WORDS:
            raise UserError(f"{line[:60]!r} is not a command of the console; use one of {', '.join(WORDS)}")
        return self._rig.begin(line, lambda: self._rig.command(words))

    def take_picture(self) -> Future[str]:
        """Take a picture, write it to the folder ``pictures``, and return its file name.

        The name consists of date and time.
        """
        return self._rig.begin("picture", self._take_picture)

    def let_go(self) -> Future[None]:
        """Switch off the lights, park the arm, switch off its torque, and close the devices."""
        self.set_live(on=False)
        return self._rig.begin("release of the devices", self._rig.let_go)

    def set_live(self, *, on: bool) -> None:
        """Switch live pictures on or off. Live pictures are taken only while clients request the state."""
        self._rig.set_live(time.monotonic() + LIVE_S if on else 0.0)

    def keep_live(self) -> None:
        """Continue live pictures, because a client has requested the state."""
        if self._rig.live_until_s > 0.0:
            self._rig.live_until_s = time.monotonic() + LIVE_S

    def _check(self) -> None:
        self._rig.let_go()

        def say(line: str) -> None:
            self._devices.read_check(line)
            self._rig.say(line)

        check(self._bench, say=say, folder=self._folders.root)

    def _take_picture(self) -> str:
        now = datetime.now().astimezone()
        path = self._folders.pictures / f"{now:%Y-%m-%d-%H%M%S}-{now.microsecond // 1000:03d}.png"
        self._rig.command(["picture", str(path)])
        return path.name
