"""Clocks, passed to drivers: the real one, and a virtual one (`rig.twin.clock`) for the emulated rig and for tests."""

import time
from typing import Protocol


class Clock(Protocol):
    """Time source of drivers and scan."""

    def now_s(self) -> float:
        """Return seconds since an arbitrary moment; never decreases."""

    def sleep(self, seconds: float) -> None:
        """Wait; return at once for zero or less."""


class SystemClock:
    """The computer's monotonic clock."""

    def now_s(self) -> float:
        """Return seconds since an arbitrary moment; never decreases."""
        return time.monotonic()

    def sleep(self, seconds: float) -> None:
        """Sleep in real time."""
        if seconds > 0.0:
            time.sleep(seconds)
