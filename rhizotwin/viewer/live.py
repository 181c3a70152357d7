"""A scan while it runs: what its pictures show, kept for the page, and the page's wish to pause, go on or stop."""

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
"""Pictures between two sketches: a sketch takes seconds, beside the scan."""
HOLD_S = 0.5
"""Between two looks at a rig that waits."""
MOST_LINES = 6
FRUSTUM_PX = 90
"""Width of the pictures that stay with their cameras."""


class Live(Observer):
    """Looks on at a scan for the browsers.

    Parameters
    ----------
    scene : as the scan knows it.
    paused : wait before the first picture.
    """

    watches_motion = True

    def __init__(self, scene: Scene, *, paused: bool = False) -> None:
        self.scene = scene
        self.total = self.done = 0
        self.looks: list[Look] = []
        """Of this run, the last one last."""
        self.lines: list[str] = []
        self.panel: tuple[float, float] | None = None
        """Darkest and brightest twentieth of the panel, of full scale."""
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

    # what the scan tells

    def on_plan(self, total: int, done: int) -> None:
        """Hear how many pictures there are."""
        self.total, self.done, self._begun_s = total, done, time.monotonic()
        self._changed()

    def on_look(self, look: Look) -> None:
        """Keep what a picture shows, and sketch now and then."""
        self.done += 1
        if self.looks:  # only the last one is shown in full
            before = self.looks[-1]
            self.looks[-1] = replace(before, image=smaller(before.image, FRUSTUM_PX))
        self.looks.append(look)
        self._worker.submit(self._take_in, look)
        self._changed()

    def on_drop(self, files: list[str]) -> None:
        """Forget pictures that were taken out."""
        self.looks = [look for look in self.looks if look.frame.file not in files]
        self.done -= len(files)
        for file in files:
            self._worker.submit(self._sketch.drop, file)
        self._changed()

    def on_line(self, text: str) -> None:
        """Keep the last lines."""
        self.lines = [*self.lines, text][-MOST_LINES:]
        self._changed()

    def holds(self) -> bool:
        """Wait a little where the scan is paused; end it where a browser asked for that."""
        with self._wake:
            begun_s = time.monotonic()
            if self.paused and not self._stop:
                self._wake.wait(HOLD_S)
                self._held_s += time.monotonic() - begun_s
            if self._stop:
                raise KeyboardInterrupt
            return self.paused

    # what browsers ask for

    def pause(self, *, paused: bool) -> None:
        """Wait before the next picture, or go on."""
        with self._wake:
            self.paused = paused
            self._wake.notify_all()
        self._changed()

    def stop(self) -> None:
        """End the scan as Ctrl-C does: lights off, arm parked; what was taken is kept."""
        with self._wake:
            self._stop = True
            self._wake.notify_all()
        self._changed()

    @property
    def stopping(self) -> bool:
        """Whether the scan was asked to end."""
        return self._stop

    def left_s(self) -> float | None:
        """Return the time left by that of the pictures so far, pauses left out; None before two of them."""
        taken = len(self.looks)
        if taken < 2:
            return None
        return (time.monotonic() - self._begun_s - self._held_s) / taken * (self.total - self.done)

    def close(self) -> None:
        """Finish the last sketch and tell the browsers that the scan is over."""
        self._worker.submit(self._carve)
        self._worker.shutdown(wait=True)
        self.ended = True
        self._changed()

    def _take_in(self, look: Look) -> None:
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
        """Let the page follow; nothing that goes wrong there may harm the scan."""
        for follow in self.on_change:
            with suppress(Exception):
                follow()


def smaller(image: Grey, width_px: int) -> Grey:
    """Return a picture at most so wide."""
    height, width = image.shape
    if width <= width_px:
        return image
    return cv2.resize(image, (width_px, max(1, round(height * width_px / width))), interpolation=cv2.INTER_AREA)
