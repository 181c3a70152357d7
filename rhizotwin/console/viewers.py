"""Viewers of results, which the console starts in separate processes when a client opens a result."""

from __future__ import annotations

import json
import os
import signal
import threading
import time
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from rhizotwin.console.messages import explained
from rhizotwin.console.reconstruction_worker import NICE
from rhizotwin.console.scan_folders import ScanFolders
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.threads import end_with_parent

MOST = 4
"""Maximum number of viewers that run at the same time. Each needs 0.4 GB for a plant of 15 days."""
IDLE_S = 300.0
"""Time after which a viewer without a browser and without unsaved corrections ends, s. A browser on a computer that was
suspended connects again within this time or asks for a new viewer."""
START_S = 120.0
"""Timeout for the start of a viewer, s. It takes 22 s on two cores with ten busy processes."""


@dataclass(frozen=True)
class _Running:
    """Process of a viewer, with the result that it has read."""

    process: Any
    stamp: int
    """Modification time of the result's ``result.json``, ns."""
    port: int
    token: str


class Viewers:
    """Starts and ends the viewers of a console.

    Parameters
    ----------
    folders : ScanFolders
        Folders of the results.
    """

    def __init__(self, folders: ScanFolders) -> None:
        self._folders = folders
        self._lock = threading.Lock()
        self._running: dict[tuple[str, str], _Running] = {}

    def open(self, name: str, *, host: str, port: int) -> tuple[int, str]:
        """Return port and token of a viewer of a result, which is started if there is none.

        Parameters
        ----------
        name : str
            Name of the scan.
        host, port : str, int
            Address on which the viewer listens, and first port to try.

        Raises
        ------
        UserError
            If the scan has no result, the result cannot be read, or `MOST` viewers are running.
        """
        folder = self._folders.result(name)
        head = folder / "result.json"
        if not head.is_file():
            raise UserError(f"the scan {name!r} has no result; add it to the queue of reconstructions first")
        stamp = head.stat().st_mtime_ns
        with self._lock:
            self._running = {key: one for key, one in self._running.items() if one.process.is_alive()}
            found = self._running.get((host, name))
            if found is None or found.stamp != stamp:
                if len(self._running) >= MOST:
                    raise UserError(
                        f"{MOST} results are open already; close a page of the viewer, and try again after {IDLE_S / 60.0:g} minutes"
                    )
                found = self._running[(host, name)] = _start(folder, stamp, host=host, port=port)
        return found.port, found.token

    def close(self) -> None:
        """End all viewers. Corrections that were not saved are lost."""
        with self._lock:
            for one in self._running.values():
                one.process.kill()
                one.process.join()


def _start(folder: Path, stamp: int, *, host: str, port: int) -> _Running:
    context = get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=view, args=(theirs, str(folder), host, port), daemon=True)
    process.start()
    theirs.close()
    told: dict[str, Any] = {"error": f"the viewer of {folder.name} could not be started; see the terminal of the console"}
    with ours, suppress(EOFError, OSError):
        if ours.poll(START_S):
            told = json.loads(ours.recv_bytes())
    if "error" in told:
        process.kill()
        raise UserError(told["error"])
    return _Running(process, stamp, told["port"], told["token"])


def view(line: Connection, result: str, host: str, port: int) -> None:
    """Display a result until no browser has been connected for `IDLE_S` and all corrections are saved.

    Parameters
    ----------
    line : Connection
        Connection to the console, over which port and token, or an error message, are sent as JSON.
    result : str
        Folder of the result.
    host, port : str, int
        Address on which the viewer listens, and first port to try.
    """
    from rhizotwin.viewer import app  # loaded in this process only

    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the console stops this process itself
    end_with_parent()
    if hasattr(os, "nice"):
        os.nice(NICE)
    try:
        viewer = app.start([Path(result)], None, host=host, port=port)
    except Exception as error:  # noqa: BLE001 - sent to the console, which shows it
        line.send_bytes(json.dumps({"error": explained(error)}).encode())
        return
    line.send_bytes(json.dumps({"port": viewer.served.port, "token": viewer.served.token}).encode())
    used_s = time.monotonic()
    while viewer.served.is_running and time.monotonic() < used_s + IDLE_S:
        if viewer.served.server.get_clients() or viewer.unsaved():
            used_s = time.monotonic()
        time.sleep(1.0)
