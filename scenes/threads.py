"""Threads that go on after an exception, which is reported, and the end of a process with the one that started it."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from multiprocessing import parent_process

PAUSE_S = 0.5
"""Time between an exception and the next call of the function, s. An error that returns at once then needs no
processor time, and is reported within a second."""


class LastingThread:
    """Thread whose function is called again if it raises an exception. The thread ends when the function returns.

    Parameters
    ----------
    run : callable
        Function of the thread.
    name : str
        Name of the thread.
    on_error : callable
        Function that is called with each exception. Its own exceptions are ignored.
    daemon : bool
        Whether the program may end before the thread.
    """

    def __init__(self, run: Callable[[], object], *, name: str, on_error: Callable[[BaseException], object], daemon: bool = True) -> None:
        self._run, self._on_error = run, on_error
        self._thread = threading.Thread(target=self._repeat, name=name, daemon=daemon)
        self._thread.start()

    def join(self) -> None:
        """Wait until the thread has ended."""
        self._thread.join()

    def _repeat(self) -> None:
        while True:
            try:
                self._run()
                return
            except BaseException as error:  # noqa: BLE001 - also SystemExit, which would end the thread without a word
                with suppress(BaseException):
                    self._on_error(error)
                time.sleep(PAUSE_S)


def end_with_parent() -> None:
    """End this process when the process that has started it by `multiprocessing` ends, even if that was killed."""
    parent = parent_process()

    def end() -> None:
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=end, name="end", daemon=True).start()


class Worker:
    """Thread that executes tasks one after another. An exception ends only its task.

    Parameters
    ----------
    name : str
        Name of the thread.
    on_error : callable
        Function that is called with the exception of a task.
    """

    def __init__(self, *, name: str, on_error: Callable[[BaseException], object]) -> None:
        self._executor = ThreadPoolExecutor(max_workers=1, thread_name_prefix=name)
        self._on_error = on_error

    def submit(self, task: Callable[[], object]) -> None:
        """Add a task."""
        self._executor.submit(task).add_done_callback(self._report)

    def wait(self) -> None:
        """Wait until all tasks that were added so far have ended."""
        self._executor.submit(lambda: None).result()

    def close(self) -> None:
        """Wait until all tasks have ended, and end the thread."""
        self._executor.shutdown()

    def _report(self, ended: Future[object]) -> None:
        if (error := ended.exception()) is not None:
            self._on_error(error)
