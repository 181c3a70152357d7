"""Recent messages of the console about scans, commands and errors, with their times."""

import logging
import re
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import asdict, dataclass
from datetime import datetime
from typing import Literal

from rhizotwin.scenes.formatting import continued, error_sentence, is_expected, printable

KEPT = 200
RESUME = re.compile("(finish the scan|start the scan again|resume) with --resume")
"""Pattern of advice that is valid only for the command line. `for_console` replaces it."""
Kind = Literal["info", "error"]


@dataclass(frozen=True, kw_only=True)
class Message:
    """Message with its time."""

    number: int
    """Consecutive number of the message."""
    time: str
    """Local time of the message, such as 14:05:10."""
    kind: Kind
    text: str


def for_console(text: str) -> str:
    """Replace advice for users of the command line in a message by advice for users of the console."""
    return printable(RESUME.sub("finish the scan, or start it again", continued(text, "console")))


def explained(error: BaseException) -> str:
    """Return a sentence about an error that the console survives, and log the traceback of an unexpected one."""
    if not is_expected(error):
        logging.getLogger(__name__).error("the console continues after an unexpected error", exc_info=error)
    return for_console(error_sentence(error))


class Messages:
    """Stores the most recent messages. Their maximum number is `KEPT`.

    Parameters
    ----------
    on_change : callable
        Function that is called after each new message.
    """

    def __init__(self, on_change: Callable[[], object]) -> None:
        self._on_change = on_change
        self._lock = threading.Lock()
        self._kept: deque[Message] = deque(maxlen=KEPT)
        self._count = 0

    def add(self, text: str, kind: Kind = "info") -> None:
        """Add a message."""
        with self._lock:
            self._count += 1
            now = datetime.now().astimezone()
            self._kept.append(Message(number=self._count, time=f"{now:%H:%M:%S}", kind=kind, text=for_console(text)))
        self._on_change()

    def error(self, text: str) -> None:
        """Add an error message."""
        self.add(text, "error")

    def plain(self) -> list[dict[str, object]]:
        """Return the messages as JSON values, with the latest message first."""
        with self._lock:
            return [asdict(message) for message in reversed(self._kept)]
