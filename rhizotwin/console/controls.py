"""Control of the rig: one client at a time has it, and every client sees who."""

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime

from rhizotwin.scenes.errors import UserError

MOST_LETTERS = 40
"""Length of a name."""


@dataclass(frozen=True, kw_only=True)
class Holder:
    """The client in control."""

    client: str
    """Identifier that the client chose at random; it is not shown to others."""
    name: str
    since: str
    """Local time, such as 14:05."""


class Controls:
    """Assigns the control of the rig.

    Parameters
    ----------
    on_change : callable
        Called when another client takes or releases control.
    """

    def __init__(self, on_change: Callable[[], object]) -> None:
        self._on_change = on_change
        self._lock = threading.Lock()
        self._holder: Holder | None = None
        self._active_s = 0.0

    def take(self, client: str, name: str) -> None:
        """Give a client control, even where another has it.

        Raises
        ------
        UserError
            For a name that is empty, too long or not printable.
        """
        name = name.strip()
        if not 0 < len(name) <= MOST_LETTERS or not name.isprintable():
            raise UserError(f"name: must be 1 to {MOST_LETTERS} printable letters")
        with self._lock:
            now = datetime.now().astimezone()
            self._holder = Holder(client=client, name=name, since=f"{now:%H:%M}")
            self._active_s = time.monotonic()
        self._on_change()

    def release(self, client: str) -> None:
        """Release control, if this client has it."""
        with self._lock:
            if self._holder is None or self._holder.client != client:
                return
            self._holder = None
        self._on_change()

    def require(self, client: str) -> None:
        """Check that a client has control.

        Raises
        ------
        UserError
            Where no client or another one has it.
        """
        with self._lock:
            holder = self._holder
            if holder is not None and holder.client == client:
                self._active_s = time.monotonic()
                return
        if holder is None:
            raise UserError("no one has control of the rig: take control first")
        raise UserError(f"{holder.name} has had control of the rig since {holder.since}: take over first")

    def touch(self, client: str) -> None:
        """Record that a client is still connected."""
        with self._lock:
            if self._holder is not None and self._holder.client == client:
                self._active_s = time.monotonic()

    def state(self, client: str) -> dict[str, object]:
        """Return who has control, as JSON values for one client."""
        with self._lock:
            holder = self._holder
            if holder is None:
                return {"name": None, "since": None, "own": False, "idle_s": None}
            own = holder.client == client
            return {"name": holder.name, "since": holder.since, "own": own, "idle_s": round(time.monotonic() - self._active_s)}
