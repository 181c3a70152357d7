"""Log of a scan: lines for the user, and events that are stored in the dataset."""

from rhizotwin.rig.clock import Clock
from rhizotwin.rig.scanning.observers import Observers
from rhizotwin.rig.scanning.session import Session


class ScanLog:
    """Log of one run of a scan, whose times continue those of earlier runs."""

    def __init__(self, session: Session, clock: Clock, user: Observers) -> None:
        self._session = session
        self._clock = clock
        self._user = user
        self._begun_s = clock.now_s()

    def now_s(self) -> float:
        """Return the time since the start of the scan, s."""
        return self._session.begun_s + self._clock.now_s() - self._begun_s

    def say(self, text: str) -> None:
        """Write a line for the user."""
        self._user.say(text)
        self._user.observer.on_line(text)

    def report(self, name: str, text: str) -> None:
        """Write the state of a device."""
        self.say(f"{name:<10} {text}")

    def note(self, event: str, text: str) -> None:
        """Write an event for the user, and add it to the log of the dataset."""
        self.record(event, text)
        self.say(text)

    def record(self, event: str, text: str) -> None:
        """Add an event to the log of the dataset only."""
        self._session.note(event, text, time_s=self.now_s())
