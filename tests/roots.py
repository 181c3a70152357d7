"""Straight roots for tests."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from rhizotwin.scenes.rsml import Root


def straight(
    start: ArrayLike, end: ArrayLike, mm: ArrayLike = 0.4, *, count: int = 21, order: int = 0, parent: int = -1, **named: Any
) -> Root:
    """Return a straight root with one diameter, or those of its ends, in mm."""
    diameters = np.linspace(*np.broadcast_to(np.asarray(mm, float), 2), count)
    return Root(points_mm=np.linspace(start, end, count, dtype=float), diameters_mm=diameters, order=order, parent=parent, **named)
