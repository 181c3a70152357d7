"""Polylines that tests string tubes on."""

from itertools import pairwise

import numpy as np


def line(*corners: tuple[float, float, float], step: float = 0.1) -> np.ndarray:
    """Return points along straight pieces."""
    pieces = []
    for a, b in pairwise(corners):
        count = max(2, round(float(np.linalg.norm(np.subtract(b, a))) / step) + 1)
        pieces.append(np.linspace(a, b, count))
    return np.concatenate([pieces[0], *(piece[1:] for piece in pieces[1:])])
