"""Present problems of the console, such as a full disk, which all clients see until they are solved."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable

from rhizotwin.console.messages import for_console
from rhizotwin.scenes.formatting import error_sentence, is_expected


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
        text = _text(part, error)
        with self._lock:
            known = self._texts.get(part) == text
            self._texts[part] = text
        if not known:
            self.announce(part, error)

    def announce(self, part: str, error: BaseException) -> None:
        """Announce an error of a part of the console that works again."""
        if not is_expected(error):
            logging.getLogger(__name__).error("%s: the console continues after an unexpected error", part, exc_info=error)
        self._say(_text(part, error))

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


def _text(part: str, error: BaseException) -> str:
    return for_console(f"{part}: {error_sentence(error)}")
