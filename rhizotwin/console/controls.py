"""Control of the rig, which only one client has at a time. All clients see the name of this client."""

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime

from rhizotwin.scenes.errors import UserError

MOST_LETTERS = 40
"""Maximum length of a client's name."""


@dataclass(frozen=True, kw_only=True)
class Holder:
    """Client that has control of the rig."""

    client: str
    """Random identifier that the client chose. It is not shown to other clients."""
    name: str
    """Name of the client, which is shown to all clients."""
    since: str
    """Local time at which the client took control, such as 14:05."""


class Controls:
    """Assigns control of the rig to one client at a time.

    Parameters
    ----------
    on_change : callable
        Function that is called when a client takes or releases control.
    """

    def __init__(self, on_change: Callable[[], object]) -> None:
        self._on_change = on_change
        self._lock = threading.Lock()
        self._holder: Holder | None = None
        self._active_s = 0.0

    def take(self, client: str, name: str) -> None:
        """Assign control to a client, even if another client has control.

        Raises
        ------
        UserError
            If the name is empty, too long or not printable.
        """
        name = name.strip()
        if not 0 < len(name) <= MOST_LETTERS or not name.isprintable():
            raise UserError(f"the name of a client must have 1 to {MOST_LETTERS} printable characters")
        with self._lock:
            now = datetime.now().astimezone()
            self._holder = Holder(client=client, name=name, since=f"{now:%H:%M}")
            self._active_s = time.monotonic()
        self._on_change()

    def release(self, client: str) -> None:
        """Release control if the given client has control."""
        with self._lock:
            if self._holder is None or self._holder.client != client:
                return
            self._holder = None
        self._on_change()

    def require(self, client: str) -> None:
        """Check that a client has control of the rig.

        Raises
        ------
        UserError
            If no client or another client has control.
        """
        with self._lock:
            holder = self._holder
            if holder is not None and holder.client == client:
                self._active_s = time.monotonic()
                return
        if holder is None:
            raise UserError("this action needs control of the rig; take control first")
        raise UserError(f"{holder.name} has had control of the rig since {holder.since}; take control first")

    def touch(self, client: str) -> None:
        """Record that a client is still connected."""
        with self._lock:
            if self._holder is not None and self._holder.client == client:
                self._active_s = time.monotonic()

    def state(self, client: str) -> dict[str, object]:
        """Return who has control of the rig, since when and for how long inactive, as JSON values.

        ``own`` states whether it is the given client.
        """
        with self._lock:
            holder = self._holder
            if holder is None:
                return {"name": None, "since": None, "own": False, "idle_s": None}
            own = holder.client == client
            return {"name": holder.name, "since": holder.since, "own": own, "idle_s": round(time.monotonic() - self._active_s)}
