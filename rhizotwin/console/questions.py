"""Questions to the person at the rig, which a client of the console answers."""

import threading
from collections.abc import Callable
from contextlib import suppress
from queue import Empty, SimpleQueue

from rhizotwin.scenes.errors import UserError

LOOK_S = 0.5
"""Polling interval, in seconds, at which a pending question checks whether it has been cancelled."""


class Questions:
    """Passes one question at a time to the clients, and returns the answer.

    Parameters
    ----------
    on_change : callable
        Function that is called when a question is asked or answered.
    """

    def __init__(self, on_change: Callable[[], object]) -> None:
        self.text = ""
        """Text of the pending question. It is empty if no question is pending."""
        self.number = 0
        """Number of the latest question, which increases with each question."""
        self._on_change = on_change
        self._lock = threading.Lock()
        self._answers: SimpleQueue[str] = SimpleQueue()

    def ask(self, question: str, *, cancelled: Callable[[], bool]) -> str:
        """Ask a question, wait for the answer and return it.

        Parameters
        ----------
        question : str
            Text of the question.
        cancelled : callable
            Function that returns True if the question is to be cancelled.

        Raises
        ------
        KeyboardInterrupt
            If the question was cancelled.
        """
        with self._lock:
            self.text = question
            self.number += 1
        self._on_change()
        try:
            while not cancelled():
                with suppress(Empty):
                    return self._answers.get(timeout=LOOK_S)
            raise KeyboardInterrupt
        finally:
            with self._lock:
                self.text = ""
                while not self._answers.empty():  # discard an answer that arrived after the cancellation
                    self._answers.get()
            self._on_change()

    def answer(self, text: str, *, number: int) -> None:
        """Answer the pending question.

        Parameters
        ----------
        text : str
            Answer.
        number : int
            Number of the question that is answered.

        Raises
        ------
        UserError
            If there is no pending question, or it has another number.
        """
        with self._lock:
            if not self.text:
                raise UserError("there is no question to answer")
            if number != self.number:
                raise UserError(f"question {number} is no longer pending; read the present question, and answer it")
            self.text = ""
            self._answers.put(text)
