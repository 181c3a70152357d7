"""Time, passed in: the real one on the bench, a virtual one (`rig.twin.clock`) in the emulated twin and in tests."""

import time
from typing import Protocol


class Clock(Protocol):
    """Where drivers and the scan get their time from."""

    def now_s(self) -> float:
        """Return seconds since an arbitrary moment; never goes back."""

    def sleep(self, seconds: float) -> None:
        """Let time pass; nothing for zero or less."""


class SystemClock:
    """The computer's monotonic clock."""

    def now_s(self) -> float:
        """Return seconds since an arbitrary moment; never goes back."""
        return time.monotonic()

    def sleep(self, seconds: float) -> None:
        """Sleep for real."""
        if seconds > 0.0:
            time.sleep(seconds)
