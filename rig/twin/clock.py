"""Virtual time, which advances only when a program waits.

Events that occur while it waits are processed at their own times.
"""

import math
import threading
import time
from typing import Protocol


class Source(Protocol):
    """Interface of a process with scheduled events."""

    def next_s(self) -> float:
        """Return the time of the next event, s.

        It is infinity if none is scheduled.
        """

    def advance_to(self, now_s: float) -> None:
        """Process all events up to the given time (s)."""


class VirtualClock:
    """Clock with virtual time, which advances without real waiting.

    It implements `rig.clock.Clock`. The time is advanced by `sleep`, and by reading from the twin's ports.
    """

    def __init__(self) -> None:
        self._now_s = 0.0
        self._sources: list[Source] = []

    def add(self, source: Source) -> None:
        """Add a source of events. Sources are processed in the order in which they were added."""
        self._sources.append(source)

    def now_s(self) -> float:
        """Return the virtual time since the creation of the twin, s."""
        return self._now_s

    def sleep(self, seconds: float) -> None:
        """Advance the virtual time by a duration, and process all events in between."""
        if seconds > 0.0:
            self.advance_to(self._now_s + seconds)

    def next_s(self) -> float:
        """Return the time of the next event of any source, s."""
        return min((source.next_s() for source in self._sources), default=math.inf)

    def advance_to(self, then_s: float) -> None:
        """Advance to the given time in seconds, and process all events in between.

        A time in the past has no effect.
        """
        while self._now_s < then_s:
            self.step(then_s)

    def step(self, limit_s: float) -> None:
        """Advance to the next event or to ``limit_s``, whichever is earlier.

        Every source is processed once.
        """
        self._now_s = max(self._now_s, min(self.next_s(), limit_s))
        for source in self._sources:
            source.advance_to(self._now_s)


class ScaledClock:
    """Clock that runs ``speed`` times as fast as the computer's clock.

    It implements `rig.clock.Clock`.
    """

    def __init__(self, speed: float = 1.0) -> None:
        self.speed = speed
        self._start_s = time.monotonic()

    def now_s(self) -> float:
        """Return the scaled time since the creation of the clock, s."""
        return (time.monotonic() - self._start_s) * self.speed

    def sleep(self, seconds: float) -> None:
        """Wait until the scaled time has advanced by the given duration."""
        if seconds > 0.0:
            time.sleep(min(seconds / self.speed, threading.TIMEOUT_MAX))
