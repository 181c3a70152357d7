"""Counters of passes over all pictures, which dominate the time of a reconstruction.

Counts belong to a context variable, so that two reconstructions in one process are separate.
"""

from __future__ import annotations

from collections import Counter
from contextvars import ContextVar
from typing import Literal, get_args

Pass = Literal["gauss_newton_steps", "renderings", "carvings"]
"""Steps of `tubes.tube_fit`, renderings of all tubes (`tubes.tube_picture`), and carved hulls (`hull.carve`)."""

_counts: ContextVar[Counter[str] | None] = ContextVar("passes", default=None)


def begin() -> None:
    """Reset the counters."""
    _counts.set(Counter())


def add(kind: Pass) -> None:
    """Count one pass, if counting was started."""
    counts = _counts.get()
    if counts is not None:
        counts[kind] += 1


def get_counts() -> dict[str, int]:
    """Return the number of passes of every kind since `begin`."""
    counts = _counts.get() or Counter()
    return {kind: counts[kind] for kind in get_args(Pass)}
