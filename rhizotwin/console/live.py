"""Live state of a running scan (latest picture, progress and coarse hull), and functions to pause and stop the scan."""

from __future__ import annotations

import gc
import threading
import time
from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray

from rhizotwin.console.hull import Hull
from rhizotwin.rig.scanning.observer import Look, Observer
from rhizotwin.scenes import frames
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.threads import Worker

CARVE_EVERY = 4
"""Number of pictures between two updates of the hull. An update takes a few seconds in a separate thread."""
HOLD_S = 0.5
"""Maximum time, in seconds, that a paused scan waits before it checks the arm again."""


class Live(Observer):
    """Scan observer that provides the live state of the scan to the console.

    Parameters
    ----------
    scene : Scene
        Nominal scene of the scan.
    on_change : callable
        Function that is called after each change, from several threads.
    on_error : callable
        Function that is called with each exception of the hull and of ``on_change``, which do not affect the scan.
    paused : bool
        Pause the scan before the first picture.
    """

    watches_motion = True

    def __init__(
        self,
        scene: Scene,
        *,
        on_change: Callable[[], object] = lambda: None,
        on_error: Callable[[BaseException], object] = lambda _: None,
        paused: bool = False,
    ) -> None:
        self.scene = scene
        self.total = self.done = 0
        self.last: Look | None = None
        """Latest picture with its measurements. It is None before the first picture."""
        self.panel: tuple[float, float] | None = None
        """5th and 95th percentiles of the panel's brightness, as fractions of full scale. They are None if no markers
        have been detected yet."""
        self.cells_mm: NDArray[np.float64] = np.zeros((0, 3))
        self.cell_mm = 1.0
        self.paused = paused
        self.ended = False
        self._on_change, self._on_error = on_change, on_error
        self._stop = False
        self._taken = 0
        self._wake = threading.Condition()
        self._hull = Hull(scene)
        self._worker = Worker(name="hull", on_error=on_error)
        self._begun_s = time.monotonic()
        self._held_s = 0.0

    def on_plan(self, total: int, done: int) -> None:
        """Set the number of planned pictures, and the number of pictures taken before an interruption."""
        self.total, self.done, self._begun_s = total, done, time.monotonic()
        self._changed()

    def on_look(self, look: Look) -> None:
        """Store the latest picture, and update the hull after every `CARVE_EVERY` pictures."""
        self.done += 1
        self._taken += 1
        self.last = look
        self._worker.submit(partial(self._add, look, carve=self._taken % CARVE_EVERY == 0))
        self._changed()

    def on_drop(self, files: list[str]) -> None:
        """Remove rejected pictures from the progress and from the hull."""
        self.done -= len(files)
        for file in files:
            self._worker.submit(partial(self._hull.drop, file))
        self._changed()

    def holds(self) -> bool:
        """Return whether the scan is paused. If it is paused, the method waits up to `HOLD_S` before it returns.

        Raises
        ------
        KeyboardInterrupt
            If `stop` was called, to end the scan like Ctrl-C.
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
        """Pause the scan before the next picture, or continue it."""
        with self._wake:
            self.paused = paused
            self._wake.notify_all()
        self._changed()

    def stop(self) -> None:
        """Stop the scan like Ctrl-C: switch off the lights, park the arm and keep the pictures."""
        with self._wake:
            self._stop = True
            self._wake.notify_all()
        self._changed()

    @property
    def stopping(self) -> bool:
        """Whether `stop` was called."""
        return self._stop

    def left_s(self) -> float | None:
        """Estimate the remaining time in seconds from the mean time per picture, without pauses.

        It is None before the second picture.
        """
        if self._taken < 2:
            return None
        return (time.monotonic() - self._begun_s - self._held_s) / self._taken * (self.total - self.done)

    def close(self) -> None:
        """Update the hull for the last time, and end its thread."""
        self._worker.submit(self._carve)
        self._worker.close()
        self.ended = True
        self._changed()
        # the pictures are part of reference cycles, which Python collects only after many further scans
        self.last, self._hull = None, Hull(self.scene)
        gc.collect()

    def _add(self, look: Look, *, carve: bool) -> None:
        frame = look.frame
        tank = self.scene.tank
        if look.sighting is not None and (tank is None or frame.table_deg is not None):
            cam_from_tank = None
            if tank is not None and frame.table_deg is not None:  # the tank does not rotate with the table
                cam_from_rig = look.sighting.cam_from_rig(frame.table_deg, direction=self.scene.turntable.direction)
                cam_from_tank = cam_from_rig @ frames.rotation_z(np.deg2rad(tank.turn_deg))
            self._hull.add(frame.file, frame.ring, look.image, look.sighting.cam_from_canister, cam_from_tank)
            self.panel = self._hull.evenness(frame.ring) or self.panel
        if carve:
            self._carve()

    def _carve(self) -> None:
        self.cells_mm, self.cell_mm = self._hull.carve()
        self._changed()

    def _changed(self) -> None:
        """Notify the console of a change. Its errors are reported, and do not affect the scan."""
        try:
            self._on_change()
        except Exception as error:  # noqa: BLE001 - a picture that cannot be displayed must not end the scan
            self._on_error(error)
