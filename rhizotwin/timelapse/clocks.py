"""Clocks for an experiment: the clock of the computer, and a clock of virtual time for the emulated rig."""

import time
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from typing import Protocol

STEP_S = 1.0
"""Interval, in seconds, at which a waiting clock checks whether the run is to be stopped."""


class Calendar(Protocol):
    """Interface of a clock."""

    def now(self) -> datetime:
        """Return the current time, UTC."""

    def wait_until(self, then: datetime, *, stop: Callable[[], bool]) -> None:
        """Wait until a given time, or until ``stop`` returns True."""

    def advance(self, seconds: float) -> None:
        """Advance the virtual time by the duration of an emulated scan.

        A clock with the time of the computer ignores the call.
        """


class SystemCalendar:
    """Clock with the time of the computer."""

    def now(self) -> datetime:
        """Return the current time of the computer, UTC."""
        return datetime.now(UTC)

    def wait_until(self, then: datetime, *, stop: Callable[[], bool]) -> None:
        """Sleep until a given time, or until ``stop`` returns True."""
        while (left_s := (then - self.now()).total_seconds()) > 0.0 and not stop():
            time.sleep(min(left_s, STEP_S))

    def advance(self, seconds: float) -> None:
        """Do nothing, because real time passes during a scan."""


class VirtualCalendar:
    """Virtual clock, which is set forward instead of waiting.

    Parameters
    ----------
    now : datetime
        Initial time, UTC.
    """

    def __init__(self, now: datetime) -> None:
        self._now = now

    def now(self) -> datetime:
        """Return the virtual time, UTC."""
        return self._now

    def wait_until(self, then: datetime, *, stop: Callable[[], bool]) -> None:
        """Set the virtual time to ``then`` without waiting.

        The time is not changed if it is already later, or if ``stop`` returns True.
        """
        if not stop():
            self._now = max(self._now, then)

    def advance(self, seconds: float) -> None:
        """Advance the virtual time by the given number of seconds."""
        self._now += timedelta(seconds=seconds)
