"""State of a running scan for the console: latest picture, progress and sketch; pause, continue and stop."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress

import numpy as np
from numpy.typing import NDArray

from rhizotwin.console.sketch import Sketch
from rhizotwin.rig.scanning.observer import Look, Observer
from rhizotwin.scenes.model import Scene

CARVE_EVERY = 4
"""Pictures between two sketches: a sketch takes seconds of a thread of its own."""
HOLD_S = 0.5
"""Interval at which a paused scan checks the arm (s)."""


class Live(Observer):
    """Observer that keeps the state of a scan for the console.

    Parameters
    ----------
    scene : Scene
        As the scan knows it.
    on_change : callable
        Called after every change, from several threads.
    paused : bool
        Wait before the first picture.
    """

    watches_motion = True

    def __init__(self, scene: Scene, *, on_change: Callable[[], object] = lambda: None, paused: bool = False) -> None:
        self.scene = scene
        self.total = self.done = 0
        self.last: Look | None = None
        """The latest picture."""
        self.panel: tuple[float, float] | None = None
        """5th and 95th percentile of the panel's brightness (fractions of full scale)."""
        self.cells_mm: NDArray[np.float64] = np.zeros((0, 3))
        self.cell_mm = 1.0
        self.paused = paused
        self.ended = False
        self._on_change = on_change
        self._stop = False
        self._taken = 0
        self._wake = threading.Condition()
        self._sketch = Sketch(scene)
        self._worker = ThreadPoolExecutor(max_workers=1, thread_name_prefix="sketch")
        self._begun_s, self._held_s = time.monotonic(), 0.0

    def on_plan(self, total: int, done: int) -> None:
        """Set the number of planned pictures, and of those that an earlier run took."""
        self.total, self.done, self._begun_s = total, done, time.monotonic()
        self._changed()

    def on_look(self, look: Look) -> None:
        """Keep the latest picture, and update the sketch from time to time."""
        self.done += 1
        self._taken += 1
        self.last = look
        self._worker.submit(self._add, look, carve=self._taken % CARVE_EVERY == 0)
        self._changed()

    def on_drop(self, files: list[str]) -> None:
        """Remove rejected pictures from the count and the sketch."""
        self.done -= len(files)
        for file in files:
            self._worker.submit(self._sketch.drop, file)
        self._changed()

    def holds(self) -> bool:
        """Return whether the scan is paused, after a short wait if it is.

        Raises
        ------
        KeyboardInterrupt
            After `stop`: ends the scan as Ctrl-C does.
        """
        with self._wake:
            begun_s = time.monotonic()
            if self.paused and not self._stop:
                self._wake.wait(HOLD_S)
                self._held_s += time.monotonic() - begun_s
            if self._stop:
                raise KeyboardInterrupt
            return self.paused

    def pause(self, *, paused: bool) -> None:
        """Pause before the next picture, or continue."""
        with self._wake:
            self.paused = paused
            self._wake.notify_all()
        self._changed()

    def stop(self) -> None:
        """End the scan as Ctrl-C does: lights off, arm parked, pictures kept."""
        with self._wake:
            self._stop = True
            self._wake.notify_all()
        self._changed()

    @property
    def stopping(self) -> bool:
        """Whether the scan is being ended by `stop`."""
        return self._stop

    def left_s(self) -> float | None:
        """Return the remaining time, from that of the pictures so far without pauses; None before two pictures."""
        if self._taken < 2:
            return None
        return (time.monotonic() - self._begun_s - self._held_s) / self._taken * (self.total - self.done)

    def close(self) -> None:
        """Finish the sketch."""
        self._worker.submit(self._carve)
        self._worker.shutdown(wait=True)
        self.ended = True
        self._changed()

    def _add(self, look: Look, *, carve: bool) -> None:
        frame = look.frame
        if look.sighting is not None:
            self._sketch.add(frame.file, frame.ring, look.image, look.sighting.cam_from_canister)
            self.panel = self._sketch.evenness(frame.ring) or self.panel
        if carve:
            self._carve()

    def _carve(self) -> None:
        self.cells_mm, self.cell_mm = self._sketch.carve()
        self._changed()

    def _changed(self) -> None:
        """Notify the console; an error there must not affect the scan."""
        with suppress(Exception):
            self._on_change()
