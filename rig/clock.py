"""Clock interface.

The real rig uses the system clock. The emulated rig and the tests use a virtual clock (`rig.twin.clock`).
"""

import time
from typing import Protocol


class Clock(Protocol):
    """Clock that drivers and scans use to measure time and to wait."""

    def now_s(self) -> float:
        """Return the monotonic time in seconds since an arbitrary reference."""

    def sleep(self, seconds: float) -> None:
        """Wait for a duration. Durations of zero or less have no effect."""


class SystemClock:
    """Monotonic clock of the computer."""

    def now_s(self) -> float:
        """Return the monotonic time in seconds since an arbitrary reference."""
        return time.monotonic()

    def sleep(self, seconds: float) -> None:
        """Wait in real time."""
        if seconds > 0.0:
            time.sleep(seconds)
