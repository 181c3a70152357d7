"""Monitoring of long work: progress, time per stage, and cancellation."""

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
"""Function that is called with the name of the stage, the number of completed steps and their total."""


class Cancelled(Exception):  # noqa: N818 - nothing went wrong
    """Raised inside work whose monitor was cancelled; nothing was written."""


class Monitor:
    """Progress, timing and cancellation of one piece of work.

    Parameters
    ----------
    progress : type of tqdm, callable, or None
        A tqdm class shows bars: ``tqdm.tqdm`` on a terminal's stderr, ``tqdm.notebook.tqdm`` or ``tqdm.auto.tqdm`` in a
        notebook. A callable is called with ``(stage, done, total)`` at every step. None shows nothing.

    Attributes
    ----------
    timings_s : dict of str to float
        Duration of each stage in seconds, in the order in which they ended.
    after_stage : callable or None
        Called at the end of every stage, for example to release memory.
    """

    def __init__(self, progress: type[Any] | Listener | None = None) -> None:
        self._bars: type[Any] | None = progress if isinstance(progress, type) else None
        self._listener: Listener | None = None if isinstance(progress, type) else progress
        self._cancelled = False
        self.timings_s: dict[str, float] = {}
        self.after_stage: Callable[[], object] | None = None

    @staticmethod
    def of(given: Monitor | type[Any] | Listener | None) -> Monitor:
        """Return a monitor unchanged, or create one from a tqdm class, a callable or None."""
        return given if isinstance(given, Monitor) else Monitor(given)

    def cancel(self) -> None:
        """Stop the work at its next step; can be called from another thread or from the listener."""
        self._cancelled = True

    def check(self) -> None:
        """Raise an error if the work was cancelled.

        Raises
        ------
        Cancelled
            After `cancel`.
        """
        if self._cancelled:
            raise Cancelled("stopped by its monitor")

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Measure the time of a stage; the times of a repeated stage are added."""
        self.check()
        begin = time.perf_counter()
        yield
        if self.after_stage is not None:
            self.after_stage()
        self.timings_s[name] = self.timings_s.get(name, 0.0) + time.perf_counter() - begin

    @contextmanager
    def steps(self, name: str, total: int, unit: str) -> Iterator[Callable[[], None]]:
        """Show a progress bar with the remaining time.

        Parameters
        ----------
        name : str
            Name of the work.
        total, unit : int, str
            Number of steps, and their unit.

        Yields
        ------
        callable
            Function to call after each step.
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
        """Apply a function to many items in parallel, with a progress bar.

        Parameters
        ----------
        work : callable
            Function applied to each item.
        name, unit : str
            Name of the work, and unit of the items.
        items : sequence of T
            Items to process.

        Returns
        -------
        list
            Results, in the order of the items.
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
    """Return the number of processors available to this process."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
