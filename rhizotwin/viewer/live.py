"""State of a running scan for its live page: pictures so far, pause and stop."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from rhizotwin.rig.scanning.observer import Look, Observer
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.picture_codec import Grey
from rhizotwin.viewer.sketch import Sketch

CARVE_EVERY = 4
"""Pictures between two sketches; a sketch takes seconds, in parallel with the scan."""
HOLD_S = 0.5
"""Interval in which a paused scan checks whether to continue."""
MOST_LINES = 6
FRUSTUM_PX = 90
"""Width of the pictures shown at their cameras."""


class Live(Observer):
    """Observer of a scan for browsers.

    Parameters
    ----------
    scene : Scene
        Scene of the scan.
    paused : bool
        Wait before the first picture.
    """

    watches_motion = True

    def __init__(self, scene: Scene, *, paused: bool = False) -> None:
        self.scene = scene
        self.total = self.done = 0
        self.looks: list[Look] = []
        """Pictures of this run, in order."""
        self.lines: list[str] = []
        self.panel: tuple[float, float] | None = None
        """5th and 95th percentile of the backlight, as fractions of full scale."""
        self.cells_mm: NDArray[np.float64] = np.zeros((0, 3))
        self.cell_mm = 1.0
        self.on_change: list[Callable[[], None]] = []
        self.paused = paused
        self.ended = False
        self._stop = False
        self._wake = threading.Condition()
        self._sketch = Sketch(scene)
        self._worker = ThreadPoolExecutor(max_workers=1, thread_name_prefix="sketch")
        self._begun_s, self._held_s = time.monotonic(), 0.0

    # calls of the scan

    def on_plan(self, total: int, done: int) -> None:
        """Store the number of pictures."""
        self.total, self.done, self._begun_s = total, done, time.monotonic()
        self._changed()

    def on_look(self, look: Look) -> None:
        """Store a picture, and update the sketch now and then."""
        self.done += 1
        if self.looks:  # only the last one is shown in full size
            before = self.looks[-1]
            self.looks[-1] = replace(before, image=shrink(before.image, FRUSTUM_PX))
        self.looks.append(look)
        self._worker.submit(self._process, look)
        self._changed()

    def on_drop(self, files: list[str]) -> None:
        """Remove pictures that were discarded."""
        self.looks = [look for look in self.looks if look.frame.file not in files]
        self.done -= len(files)
        for file in files:
            self._worker.submit(self._sketch.drop, file)
        self._changed()

    def on_line(self, text: str) -> None:
        """Store the last lines of output."""
        self.lines = [*self.lines, text][-MOST_LINES:]
        self._changed()

    def holds(self) -> bool:
        """Wait a moment if the scan is paused; raise KeyboardInterrupt if it was stopped."""
        with self._wake:
            begun_s = time.monotonic()
            if self.paused and not self._stop:
                self._wake.wait(HOLD_S)
                self._held_s += time.monotonic() - begun_s
            if self._stop:
                raise KeyboardInterrupt
            return self.paused

    # calls of browsers

    def pause(self, *, paused: bool) -> None:
        """Pause before the next picture, or continue."""
        with self._wake:
            self.paused = paused
            self._wake.notify_all()
        self._changed()

    def stop(self) -> None:
        """Stop the scan like Ctrl-C: lights off, arm parked, pictures kept."""
        with self._wake:
            self._stop = True
            self._wake.notify_all()
        self._changed()

    @property
    def stopping(self) -> bool:
        """Whether the scan was stopped."""
        return self._stop

    def left_s(self) -> float | None:
        """Estimate the remaining time from the pictures so far, without pauses; None before two pictures."""
        taken = len(self.looks)
        if taken < 2:
            return None
        return (time.monotonic() - self._begun_s - self._held_s) / taken * (self.total - self.done)

    def close(self) -> None:
        """Finish the last sketch and mark the scan as finished."""
        self._worker.submit(self._carve)
        self._worker.shutdown(wait=True)
        self.ended = True
        self._changed()

    def _process(self, look: Look) -> None:
        frame = look.frame
        if look.sighting is not None:
            self._sketch.add(frame.file, frame.ring, look.image, look.sighting.cam_from_canister)
            self.panel = self._sketch.evenness(frame.ring) or self.panel
        if len(self.looks) % CARVE_EVERY == 0:
            self._carve()

    def _carve(self) -> None:
        self.cells_mm, self.cell_mm = self._sketch.carve()
        self._changed()

    def _changed(self) -> None:
        """Update the page; errors there must not affect the scan."""
        for follow in self.on_change:
            with suppress(Exception):
                follow()


def shrink(image: Grey, width_px: int) -> Grey:
    """Resize a picture to at most a width."""
    height, width = image.shape
    if width <= width_px:
        return image
    return cv2.resize(image, (width_px, max(1, round(height * width_px / width))), interpolation=cv2.INTER_AREA)
