"""How long work tells how far it is, how long each of its stages took, and how it is told to stop."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any, TypeVar

T = TypeVar("T")
U = TypeVar("U")

Listener = Callable[[str, int, int], object]
"""Hears of every step: what is being done, how many steps of it are done, and how many there are."""


class Cancelled(Exception):  # noqa: N818 - nothing went wrong
    """Raised inside work whose monitor was cancelled; nothing was written."""


class Monitor:
    """Progress, clock and brake of one piece of work.

    Parameters
    ----------
    progress : type of tqdm, callable, or None
        A class of tqdm's shows bars: ``tqdm.tqdm`` on a terminal's stderr, ``tqdm.notebook.tqdm`` or ``tqdm.auto.tqdm``
        in a notebook. A callable is told ``(stage, done, total)`` at every step. None is silent.

    Attributes
    ----------
    timings_s : dict of str to float
        Seconds that each stage took, in the order in which they ended.
    after_stage : callable or None
        Called at the end of every stage, such as to give memory back.
    """

    def __init__(self, progress: type[Any] | Listener | None = None) -> None:
        self._bars: type[Any] | None = progress if isinstance(progress, type) else None
        self._listener: Listener | None = None if isinstance(progress, type) else progress
        self._cancelled = False
        self.timings_s: dict[str, float] = {}
        self.after_stage: Callable[[], object] | None = None

    @staticmethod
    def of(given: Monitor | type[Any] | Listener | None) -> Monitor:
        """Return a monitor as it is, or one around a bar, a callable or nothing."""
        return given if isinstance(given, Monitor) else Monitor(given)

    def cancel(self) -> None:
        """Stop the work at its next step; may be called from another thread or from the listener."""
        self._cancelled = True

    def check(self) -> None:
        """Go on, unless cancelled.

        Raises
        ------
        Cancelled
            After `cancel`.
        """
        if self._cancelled:
            raise Cancelled("stopped by its monitor")

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time a stage; a stage that is gone through again adds to its time."""
        self.check()
        begin = time.perf_counter()
        yield
        if self.after_stage is not None:
            self.after_stage()
        self.timings_s[name] = self.timings_s.get(name, 0.0) + time.perf_counter() - begin

    @contextmanager
    def steps(self, name: str, total: int, unit: str) -> Iterator[Callable[[], None]]:
        """Show a bar with the time left.

        Parameters
        ----------
        name : str
            What is done.
        total, unit : int, str
            How many steps, and of what.

        Yields
        ------
        callable
            To be called after each step.
        """
        bar = None if self._bars is None else self._bars(total=total, desc=name, unit=unit, dynamic_ncols=True)
        done = 0

        def step() -> None:
            nonlocal done
            done += 1
            if bar is not None:
                bar.update()
            if self._listener is not None:
                self._listener(name, done, total)
            self.check()

        try:
            yield step
        finally:
            if bar is not None:
                bar.close()

    def each(self, work: Callable[[T], U], name: str, items: Sequence[T], unit: str = "view") -> list[U]:
        """Do something for many items in parallel, with a bar.

        Parameters
        ----------
        work : callable
            What is done for one.
        name, unit : str
            What is done, and for what.
        items : sequence of T
            One after the other.

        Returns
        -------
        list
            What the work returned, in the order of the items.
        """
        with ThreadPoolExecutor(max_workers=threads()) as pool, self.steps(name, len(items), unit) as step:
            done = []
            try:
                for item in pool.map(work, items):
                    done.append(item)
                    step()
            except BaseException:
                pool.shutdown(wait=False, cancel_futures=True)
                raise
            return done


def threads() -> int:
    """Return how many processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
