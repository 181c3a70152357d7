"""Clock interface: the real clock on the bench, a virtual one (`rig.twin.clock`) in the emulated twin and in tests."""

import time
from typing import Protocol


class Clock(Protocol):
    """Source of time for drivers and scans."""

    def now_s(self) -> float:
        """Return monotonic seconds since an arbitrary moment."""

    def sleep(self, seconds: float) -> None:
        """Wait; no effect for zero or less."""


class SystemClock:
    """The computer's monotonic clock."""

    def now_s(self) -> float:
        """Return monotonic seconds since an arbitrary moment."""
        return time.monotonic()

    def sleep(self, seconds: float) -> None:
        """Wait in real time."""
        if seconds > 0.0:
            time.sleep(seconds)
