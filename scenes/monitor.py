"""Monitoring of long computations: progress, time per stage, and cancellation."""

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
"""Type of a function that is called with the name of the stage, the number of completed steps, and the total number of
steps."""


class Cancelled(Exception):  # noqa: N818 - nothing went wrong
    """Raised in a computation whose monitor was cancelled. No output was written."""


class Monitor:
    """Progress, timing and cancellation of a computation.

    Parameters
    ----------
    progress : type of tqdm, callable, or None
        A tqdm class shows progress bars: ``tqdm.tqdm`` in a terminal (on stderr), ``tqdm.notebook.tqdm`` or
        ``tqdm.auto.tqdm`` in a notebook. A callable is called with ``(stage, done, total)`` at every step. None shows
        no progress.

    Attributes
    ----------
    timings_s : dict of str to float
        Duration of each stage in seconds, in the order in which the stages ended.
    after_stage : callable or None
        Function that is called at the end of every stage, for example to release memory.
    """

    def __init__(self, progress: type[Any] | Listener | None = None) -> None:
        self._bars: type[Any] | None = progress if isinstance(progress, type) else None
        self._listener: Listener | None = None if isinstance(progress, type) else progress
        self._cancelled = False
        self.timings_s: dict[str, float] = {}
        self.after_stage: Callable[[], object] | None = None

    @staticmethod
    def of(given: Monitor | type[Any] | Listener | None) -> Monitor:
        """Return a monitor unchanged. A tqdm class, a callable or None is converted to a monitor."""
        return given if isinstance(given, Monitor) else Monitor(given)

    def cancel(self) -> None:
        """Stop the computation at its next step. The method can be called from another thread or from the listener."""
        self._cancelled = True

    def check(self) -> None:
        """Raise an error if the computation was cancelled.

        Raises
        ------
        Cancelled
            If `cancel` was called.
        """
        if self._cancelled:
            raise Cancelled("the computation was cancelled")

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Measure the duration of a stage, which is a ``with`` block. The durations of a repeated stage are added."""
        self.check()
        begin = time.perf_counter()
        yield
        if self.after_stage is not None:
            self.after_stage()
        self.timings_s[name] = self.timings_s.get(name, 0.0) + time.perf_counter() - begin

    @contextmanager
    def steps(self, name: str, total: int, unit: str) -> Iterator[Callable[[], None]]:
        """Show a progress bar and the remaining time during a ``with`` block.

        Parameters
        ----------
        name : str
            Name of the computation.
        total, unit : int, str
            Number of steps, and the unit in which they are counted.

        Yields
        ------
        callable
            Function that the caller calls after each step.
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
            Function that is applied to each item.
        name, unit : str
            Name of the computation, and unit in which the items are counted.
        items : sequence of T
            Items to process.

        Returns
        -------
        list
            Results in the order of the items.
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
