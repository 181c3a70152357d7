"""Time of day in an experiment: that of the computer, or virtual time for the emulated rig."""

import time
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from typing import Protocol

STEP_S = 1.0
"""Interval at which a wait looks whether the run shall end."""


class Calendar(Protocol):
    """Time of day."""

    def now(self) -> datetime:
        """Return the time, UTC."""

    def wait_until(self, then: datetime, *, stop: Callable[[], bool]) -> None:
        """Return at a time, or as soon as ``stop`` returns True."""

    def advance(self, seconds: float) -> None:
        """Let the time pass that an emulated scan has taken; real scans take theirs by themselves."""


class SystemCalendar:
    """Time of the computer."""

    def now(self) -> datetime:
        """Return the time, UTC."""
        return datetime.now(UTC)

    def wait_until(self, then: datetime, *, stop: Callable[[], bool]) -> None:
        """Sleep."""
        while (left_s := (then - self.now()).total_seconds()) > 0.0 and not stop():
            time.sleep(min(left_s, STEP_S))

    def advance(self, seconds: float) -> None:
        """Do nothing."""


class VirtualCalendar:
    """Time that passes at once when somebody waits.

    Parameters
    ----------
    now : datetime
        Time at the start, UTC.
    """

    def __init__(self, now: datetime) -> None:
        self._now = now

    def now(self) -> datetime:
        """Return the time, UTC."""
        return self._now

    def wait_until(self, then: datetime, *, stop: Callable[[], bool]) -> None:  # noqa: ARG002 - the wait is over at once
        """Go to the time at once."""
        self._now = max(self._now, then)

    def advance(self, seconds: float) -> None:
        """Let time pass."""
        self._now += timedelta(seconds=seconds)
