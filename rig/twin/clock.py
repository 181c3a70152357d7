"""Virtual time, which advances only by waiting; events in between occur at their own times."""

import math
import threading
import time
from typing import Protocol


class Source(Protocol):
    """A process with events in time."""

    def next_s(self) -> float:
        """Return the time of its next event; infinity if there is none."""

    def advance_to(self, now_s: float) -> None:
        """Process events up to now."""


class VirtualClock:
    """A `rig.clock.Clock` whose time advances by `sleep` (and by reads of the twin's ports), without waiting."""

    def __init__(self) -> None:
        self._now_s = 0.0
        self._sources: list[Source] = []

    def add(self, source: Source) -> None:
        """Add a source of events; sources are processed in the order in which they were added."""
        self._sources.append(source)

    def now_s(self) -> float:
        """Return seconds of virtual time since the creation of the twin."""
        return self._now_s

    def sleep(self, seconds: float) -> None:
        """Advance virtual time."""
        if seconds > 0.0:
            self.advance_to(self._now_s + seconds)

    def next_s(self) -> float:
        """Return the time of the next event of any source."""
        return min((source.next_s() for source in self._sources), default=math.inf)

    def advance_to(self, then_s: float) -> None:
        """Advance to a time, processing every event in between; times in the past are ignored."""
        while self._now_s < then_s:
            self.step(then_s)

    def step(self, limit_s: float) -> None:
        """Advance to the next event or to ``limit_s``, whichever comes first, and process every source once."""
        self._now_s = max(self._now_s, min(self.next_s(), limit_s))
        for source in self._sources:
            source.advance_to(self._now_s)


class ScaledClock:
    """A `rig.clock.Clock` that runs ``speed`` times as fast as the computer's."""

    def __init__(self, speed: float = 1.0) -> None:
        self.speed = speed
        self._start_s = time.monotonic()

    def now_s(self) -> float:
        """Return scaled seconds since its creation."""
        return (time.monotonic() - self._start_s) * self.speed

    def sleep(self, seconds: float) -> None:
        """Wait in real time, divided by the speed."""
        if seconds > 0.0:
            time.sleep(min(seconds / self.speed, threading.TIMEOUT_MAX))
