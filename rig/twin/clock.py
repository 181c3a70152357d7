"""Virtual time, which passes only while a program waits; events occur at their exact times."""

import math
import threading
import time
from typing import Protocol


class Source(Protocol):
    """Source of events."""

    def next_s(self) -> float:
        """Return the time of the next event; infinity if there is none."""

    def advance_to(self, now_s: float) -> None:
        """Process all events until a time."""


class VirtualClock:
    """A `rig.clock.Clock` whose time passes by `sleep` (and by reads of the twin's ports), at once."""

    def __init__(self) -> None:
        self._now_s = 0.0
        self._sources: list[Source] = []

    def add(self, source: Source) -> None:
        """Add a source; sources are served in the order of addition."""
        self._sources.append(source)

    def now_s(self) -> float:
        """Return seconds of virtual time since the start."""
        return self._now_s

    def sleep(self, seconds: float) -> None:
        """Let virtual time pass."""
        if seconds > 0.0:
            self.advance_to(self._now_s + seconds)

    def next_s(self) -> float:
        """Return the time of the next event of any source."""
        return min((source.next_s() for source in self._sources), default=math.inf)

    def advance_to(self, then_s: float) -> None:
        """Advance to a time, processing all events on the way; times in the past are ignored."""
        while self._now_s < then_s:
            self.step(then_s)

    def step(self, limit_s: float) -> None:
        """Advance to the next event or to ``limit_s``, whichever comes first, and serve every source once."""
        self._now_s = max(self._now_s, min(self.next_s(), limit_s))
        for source in self._sources:
            source.advance_to(self._now_s)


class ScaledClock:
    """A `rig.clock.Clock` that runs ``speed`` times as fast as the computer's clock."""

    def __init__(self, speed: float = 1.0) -> None:
        self.speed = speed
        self._start_s = time.monotonic()

    def now_s(self) -> float:
        """Return scaled seconds since the start."""
        return (time.monotonic() - self._start_s) * self.speed

    def sleep(self, seconds: float) -> None:
        """Sleep for the scaled time."""
        if seconds > 0.0:
            time.sleep(min(seconds / self.speed, threading.TIMEOUT_MAX))
