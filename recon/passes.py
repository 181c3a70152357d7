"""Count the passes over all pictures, which most of a reconstruction's time goes into.

Counts follow the work that began them (a context variable): two reconstructions in one process do not mix.
"""

from __future__ import annotations

from collections import Counter
from contextvars import ContextVar
from typing import Literal, get_args

Pass = Literal["gauss_newton_steps", "renderings", "carvings"]
"""Steps of `tubes.tube_fit`, pictures of all tubes in some views (`tubes.tube_picture`), and hulls (`hull.carve`)."""

_counts: ContextVar[Counter[str] | None] = ContextVar("passes", default=None)


def begin() -> None:
    """Count from zero."""
    _counts.set(Counter())


def add(kind: Pass) -> None:
    """Count one pass; nothing where nobody began to count."""
    counts = _counts.get()
    if counts is not None:
        counts[kind] += 1


def counted() -> dict[str, int]:
    """Return the number of passes of every kind since `begin`."""
    counts = _counts.get() or Counter()
    return {kind: counts[kind] for kind in get_args(Pass)}
