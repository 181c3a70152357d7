"""Questions to the person at the rig, answered by a client."""

import threading
from collections.abc import Callable
from contextlib import suppress
from queue import Empty, SimpleQueue

from rhizotwin.scenes.errors import UserError

LOOK_S = 0.5
"""Interval at which a waiting question looks whether it is cancelled (s)."""


class Questions:
    """One question at a time.

    Parameters
    ----------
    on_change : callable
        Called when a question is asked or answered.
    """

    def __init__(self, on_change: Callable[[], object]) -> None:
        self.text = ""
        """The question; empty when nothing is asked."""
        self._on_change = on_change
        self._lock = threading.Lock()
        self._answers: SimpleQueue[str] = SimpleQueue()

    def ask(self, question: str, *, cancelled: Callable[[], bool]) -> str:
        """Ask, and wait for the answer.

        Parameters
        ----------
        question : str
            For a person.
        cancelled : callable
            Whether the wait shall end.

        Raises
        ------
        KeyboardInterrupt
            When the wait was cancelled.
        """
        with self._lock:
            self.text = question
        self._on_change()
        try:
            while not cancelled():
                with suppress(Empty):
                    return self._answers.get(timeout=LOOK_S)
            raise KeyboardInterrupt
        finally:
            with self._lock:
                self.text = ""
                while not self._answers.empty():  # the answer of a second client
                    self._answers.get()
            self._on_change()

    def answer(self, text: str) -> None:
        """Answer the question.

        Raises
        ------
        UserError
            Where nothing is asked.
        """
        with self._lock:
            if not self.text:
                raise UserError("nothing is asked at present")
            self.text = ""
            self._answers.put(text)
