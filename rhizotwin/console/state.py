"""State of the console as JSON values for its clients."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from rhizotwin.console.plants import NOTHING

if TYPE_CHECKING:
    from rhizotwin.console.console import Console


SHARED_S = 0.5
"""Time for which waiting clients receive the state that was collected for one of them, if there is no newer version, s.
Only changes of folders by other programs have no version."""


class StateView:
    """Collects the state of a console for its clients.

    Parameters
    ----------
    console : Console
        Console whose state is collected.
    """

    def __init__(self, console: Console) -> None:
        self._console = console
        self._lock = threading.Lock()
        self._collecting = threading.Lock()
        self._shared: tuple[float, dict[str, Any]] = (-SHARED_S, {"version": -1})
        """State for all clients, and the time at which it was collected, s."""
        self._hull: tuple[int, Any] = (0, None)
        self._last: dict[str, Any] = {"plants": NOTHING, "scans": [], "schedule": None}
        """Values of the parts of the state that are read from the disk, when they were read last."""

    def plain(self, client: str, *, shared: bool) -> dict[str, Any]:
        """Return the complete state of the console as JSON values.

        It includes whether ``client`` has control of the rig. If ``shared``, other parts may have been collected for
        another client.
        """
        console = self._console
        with self._collecting:
            collected_s, state = self._shared
            if not shared or state["version"] != console.version or time.monotonic() > collected_s + SHARED_S:
                state = self._collect()
                self._shared = time.monotonic(), state
        return state | {"controls": console.controls.state(client), "live": console.rig.live_until_s > time.monotonic()}

    def _collect(self) -> dict[str, Any]:
        """Return the state without the parts that depend on the client or the time."""
        console = self._console
        version = console.version  # read first, so that a later change is not missed
        queue = console.queue.plain()
        plants, visits = self._read("plants", console.plants.plain)
        return {
            "version": version,
            "rig": self._rig(),
            "devices": console.devices.plain(),
            "activity": console.rig.busy,
            "open": console.rig.open,
            "picture": self._picture(),
            "scan": None if console.scan is None else console.scan.plain(),
            "question_number": console.questions.number,  # read first, so that an answer to an earlier question is rejected
            "question": console.questions.text,
            "hull": self._hull_state(),
            "plants": plants,
            "schedule": self._read("schedule", lambda: self._schedule(visits)),
            "scans": self._read("scans", lambda: self._scans(queue)),
            "queue": queue,
            "messages": console.messages.plain(),
            "problems": console.problems.plain(),
        }

    def _read(self, part: str, read: Callable[[], Any]) -> Any:
        """Return a part of the state that is read from the disk.

        If it cannot be read, for example because the disk is full, the part that was read last is returned.
        """
        name = f"{part} as they were last read"
        try:
            self._last[part] = read()
        except Exception as error:  # noqa: BLE001 - clients need the other parts, above all to stop a scan
            self._console.problems.report(name, error)
        else:
            self._console.problems.solve(name)
        return self._last[part]

    def _rig(self) -> dict[str, Any]:
        bench = self._console.bench
        twin = bench.pictures
        return {
            "name": bench.rig.name,
            "emulated": twin is not None,
            "scene": bench.scene.name,
            "arm": bench.rig.arm is not None,
            "sketch": twin is not None and twin.fidelity == "sketch",
            "views": sum(ring.views for ring in bench.scene.plan.rings),
        }

    def _picture(self) -> dict[str, Any] | None:
        shown = self._console.shown
        if shown is None:
            return None
        return {"number": shown.number, "title": shown.title, "meters": [asdict(meter) for meter in shown.meters]}

    def _schedule(self, visits: dict[str, Any]) -> dict[str, Any] | None:
        experiment, schedule = self._console.experiment, self._console.schedule
        if experiment is None:
            return None
        state = "stopped" if schedule is None else "stopping" if schedule.stopping else "running"
        return {"name": experiment.name, "state": state, "growth": self._console.folders.growth() is not None, **visits}

    def _hull_state(self) -> dict[str, object]:
        """Return the size of the canister, and the version and number of cells of the hull, as JSON values."""
        scan = self._console.scan
        can = self._console.bench.scene.canister
        cells = None if scan is None else scan.live.cells_mm
        with self._lock:
            if cells is not self._hull[1]:
                self._hull = self._hull[0] + 1, cells
            number = self._hull[0]
        size = {"radius_mm": can.outer_radius_mm, "height_mm": can.height_mm}
        return {"number": number, "cells": 0 if cells is None else len(cells), **size}

    def _scans(self, queue: list[dict[str, object]]) -> list[dict[str, object]]:
        folders, scan = self._console.folders, self._console.scan
        jobs = {job["scan"]: job["state"] for job in queue}
        running = scan.name if scan is not None and not scan.live.ended else ""
        listed = []
        for entry in folders.list_scans():
            result = folders.result_of(entry.name)
            more = {"running": entry.name == running, "queue": jobs.get(entry.name, "")}
            listed.append(asdict(entry) | more | {"result": None if result is None else asdict(result)})
        return listed
