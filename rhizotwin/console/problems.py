"""Present problems of the console, such as a full disk, which all clients see until they are solved."""

from __future__ import annotations

import threading
from collections.abc import Callable

from rhizotwin.console.messages import explained, for_console
from rhizotwin.scenes.formatting import error_sentence


class Problems:
    """Stores one problem for each part of the console.

    Parameters
    ----------
    say : callable
        Function that is called with the text of each new problem.
    on_change : callable
        Function that is called when a problem was solved.
    """

    def __init__(self, say: Callable[[str], object], on_change: Callable[[], object]) -> None:
        self._say, self._on_change = say, on_change
        self._lock = threading.Lock()
        self._texts: dict[str, str] = {}

    def report(self, part: str, error: BaseException) -> None:
        """Set the problem of a part of the console, and announce it unless it is already known."""
        text = for_console(f"{part}: {error_sentence(error)}")
        with self._lock:
            known = self._texts.get(part)
            self._texts[part] = text
        if text != known:
            self.announce(part, error)

    def announce(self, part: str, error: BaseException) -> None:
        """Announce an error of a part of the console that works again."""
        self._say(f"{part}: {explained(error)}")

    def solve(self, part: str) -> None:
        """Remove the problem of a part of the console, if it has one."""
        with self._lock:
            known = self._texts.pop(part, None)
        if known is not None:
            self._on_change()

    def plain(self) -> list[str]:
        """Return the texts of the present problems."""
        with self._lock:
            return list(self._texts.values())
