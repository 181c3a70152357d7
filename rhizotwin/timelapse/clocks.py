"""Clocks for an experiment: the clock of the computer, and a clock of virtual time for the emulated rig."""

import time
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from typing import Protocol

STEP_S = 1.0
"""Interval, in seconds, at which a waiting clock checks whether the run is to be stopped."""
STEP = timedelta(minutes=1)
"""Step of the computer's clock that is not a correction of its drift. A clock that drifts by 100 ppm, as those of
computers at most do, gains a minute in a week, and is corrected far more often."""
SYNCHRONISED = timedelta(minutes=15)
"""Time after the start of a computer within which its clock may still be set for the first time. A Raspberry Pi has no
clock of its own, and begins with the time at which it was switched off."""


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


def uptime_s() -> float:
    """Return the time since the computer was started, s.

    Unlike `time.monotonic`, it includes the time for which the computer was suspended, where the system counts it.
    """
    counts = getattr(time, "CLOCK_BOOTTIME", None) or getattr(time, "CLOCK_MONOTONIC", None)
    return time.monotonic() if counts is None else time.clock_gettime(counts)


class SystemCalendar:
    """Clock with the time of the computer when it was created, plus the time elapsed since.

    Steps of the computer's clock above `STEP` therefore neither skip nor delay a scan. Smaller corrections, and the
    first synchronisation after the start of a computer, are followed.

    Parameters
    ----------
    say : callable
        Function that receives a message when the computer's clock was set.
    """

    def __init__(self, say: Callable[[str], None] = lambda _: None) -> None:
        self._say = say
        self._zero = self._told = datetime.now(UTC) - timedelta(seconds=uptime_s())

    def now(self) -> datetime:
        """Return the current time, UTC."""
        elapsed = timedelta(seconds=uptime_s())
        zero = datetime.now(UTC) - elapsed
        if abs(zero - self._zero) < STEP or elapsed < SYNCHRONISED:
            self._zero = self._told = zero
        elif abs(zero - self._told) >= STEP:
            self._told = zero
            self._say(
                f"the clock of this computer was set from {self._zero + elapsed:%Y-%m-%d %H:%M} to {zero + elapsed:%Y-%m-%d %H:%M} UTC; "
                "the schedule continues by the elapsed time; if the new time is right, restart the run"
            )
        return self._zero + elapsed

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
