"""Progress display in a terminal: one bar for the whole computation, with the current stage and the remaining time.

If the output is not a terminal, one line per stage is written instead.
"""

from __future__ import annotations

import os
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, Self

from tqdm import tqdm

from rhizotwin.scenes.monitor import Monitor

COLOUR = "#2e8b57"
_FORM = "{percentage:3.0f} %|{bar}| {desc}, {elapsed} so far, {remaining} left"
BEAT_S = 1.0
"""Interval between updates of the bar, s. Because of these updates, the displayed time advances even in stages without
steps."""
_UNKNOWN = 0.02
"""Fraction of the total time that is assumed for a stage whose duration is unknown."""


class OneBar(Monitor):
    """Monitor with a single progress bar for all stages.

    Parameters
    ----------
    shares : mapping of str to float
        Approximate relative durations of the stages, which determine the position of the bar. The remaining time is
        extrapolated from the elapsed time.
    quiet : bool
        Whether to suppress all output.
    verbose : bool
        Whether to write a line with the duration of each stage even if a bar is shown.
    stream : text stream, optional
        Stream to which the bar is written; stderr by default.
    bars : type of tqdm, optional
        Class of the bar, such as ``tqdm.auto.tqdm`` in a notebook. The bar is then shown even without a terminal.
    """

    def __init__(
        self,
        shares: Mapping[str, float],
        *,
        quiet: bool = False,
        verbose: bool = False,
        stream: Any = None,
        bars: type[Any] | None = None,
    ) -> None:
        super().__init__()
        total = sum(shares.values()) or 1.0
        self._shares = {name: share / total for name, share in shares.items()}
        self._stream = sys.stderr if stream is None else stream
        watched = bool(getattr(self._stream, "isatty", lambda: False)())
        self._lines = not quiet and bars is None and (verbose or not watched)
        self._bar: Any = None
        self._begun, self._done, self._part, self._stage = time.perf_counter(), 0.0, 0.0, ""
        if (watched or bars is not None) and not quiet:
            colour = None if "NO_COLOR" in os.environ else COLOUR
            where = {"file": self._stream, "leave": False} if bars is None else {}
            self._bar = (bars or tqdm)(total=1.0, bar_format=_FORM, dynamic_ncols=True, colour=colour, **where)
            self._over = threading.Event()
            threading.Thread(target=self._beat, name="bar", daemon=True).start()

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Show the name of a stage during a ``with`` block, and measure its duration."""
        with super().stage(name):
            self._stage, self._part = name, 0.0
            self._show()
            yield
        self._done = min(1.0, self._done + self._shares.get(name, _UNKNOWN))
        self._part = 0.0
        self._show()
        if self._lines:
            line = f"{name}: {self.timings_s[name]:.1f} s"
            if self._bar is None:
                print(line, file=self._stream, flush=True)
            else:
                self._bar.write(line, file=self._stream)

    @contextmanager
    def steps(self, name: str, total: int, unit: str) -> Iterator[Callable[[], None]]:
        """Advance the bar with each step of a stage, during a ``with`` block.

        Parameters
        ----------
        name : str
            Name of the stage.
        total, unit : int, str
            Number of steps, and the unit in which they are counted.

        Returns
        -------
        iterator of callable
            Function that the caller calls after each step.
        """
        with super().steps(name, total, unit) as step:
            done = 0

            def shown() -> None:
                nonlocal done
                done += 1
                self._part = done / max(total, 1)
                self._show()
                step()

            yield shown

    def close(self) -> None:
        """Remove the bar from the terminal."""
        bar, self._bar = self._bar, None
        if bar is not None:
            bar.n = max(bar.n, self._done)
            self._over.set()
            bar.close()

    def say(self, text: str) -> None:
        """Print a line on stdout, above the bar."""
        tqdm.write(text)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _beat(self) -> None:
        """Update the bar at regular intervals."""
        while not self._over.wait(BEAT_S):
            bar = self._bar
            if bar is not None:
                bar.refresh()

    def _show(self) -> None:
        bar = self._bar
        if bar is not None:
            bar.set_description_str(self._stage, refresh=False)
            now = self._done + self._part * self._shares.get(self._stage, _UNKNOWN)
            bar.n = min(1.0, max(bar.n, now))
            bar.refresh()
