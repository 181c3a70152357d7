"""Virtual time: it passes only when somebody waits, and whatever happens meanwhile happens at its own moment."""

import math
import threading
import time
from typing import Protocol


class Source(Protocol):
    """Something that changes with time."""

    def next_s(self) -> float:
        """Return when it next does something by itself; infinity when nothing is to come."""

    def advance_to(self, now_s: float) -> None:
        """Do what is due up to now."""


class VirtualClock:
    """A `rig.clock.Clock` whose time passes by `sleep` (and by reads of the twin's ports), at once."""

    def __init__(self) -> None:
        self._now_s = 0.0
        self._sources: list[Source] = []

    def add(self, source: Source) -> None:
        """Let a source take part; sources are served in the order in which they were added."""
        self._sources.append(source)

    def now_s(self) -> float:
        """Return seconds of virtual time since the twin was made."""
        return self._now_s

    def sleep(self, seconds: float) -> None:
        """Let virtual time pass."""
        if seconds > 0.0:
            self.advance_to(self._now_s + seconds)

    def next_s(self) -> float:
        """Return when the next source does something by itself."""
        return min((source.next_s() for source in self._sources), default=math.inf)

    def advance_to(self, then_s: float) -> None:
        """Go to a moment, stopping at every event on the way; the past is ignored."""
        while self._now_s < then_s:
            self.step(then_s)

    def step(self, limit_s: float) -> None:
        """Go to the next event or to ``limit_s``, whichever comes first, and serve every source once."""
        self._now_s = max(self._now_s, min(self.next_s(), limit_s))
        for source in self._sources:
            source.advance_to(self._now_s)


class ScaledClock:
    """A `rig.clock.Clock` that runs ``speed`` times as fast as the computer's."""

    def __init__(self, speed: float = 1.0) -> None:
        self.speed = speed
        self._start_s = time.monotonic()

    def now_s(self) -> float:
        """Return seconds since it was made, on its own scale."""
        return (time.monotonic() - self._start_s) * self.speed

    def sleep(self, seconds: float) -> None:
        """Sleep for real, less long by the speed."""
        if seconds > 0.0:
            time.sleep(min(seconds / self.speed, threading.TIMEOUT_MAX))
