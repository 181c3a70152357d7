"""Counters of passes over all pictures, which account for most of a reconstruction's run time.

The counters are stored in a context variable, so that concurrent reconstructions in one process are counted separately.
"""

from __future__ import annotations

from collections import Counter
from contextvars import ContextVar
from typing import Literal, get_args

Pass = Literal["gauss_newton_steps", "renderings", "carvings"]
"""Kind of pass over all pictures: a Gauss-Newton step (`tubes.tube_fit`), a rendering of all tubes
(`tubes.tube_picture`), or the carving of a hull (`hull.carve`)."""

_counts: ContextVar[Counter[str] | None] = ContextVar("passes", default=None)


def begin() -> None:
    """Reset the counters and start counting."""
    _counts.set(Counter())


def add(kind: Pass) -> None:
    """Count one pass of the given kind. Nothing is counted before `begin` is called."""
    counts = _counts.get()
    if counts is not None:
        counts[kind] += 1


def get_counts() -> dict[str, int]:
    """Return the number of passes of every kind since `begin`, keyed by the kind."""
    counts = _counts.get() or Counter()
    return {kind: counts[kind] for kind in get_args(Pass)}
