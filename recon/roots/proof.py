"""What each part of the tubes explains of the pictures, and what it leaves: the evidence that a root is there."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.tubes.tube_picture import FULLEST, PIXEL_SIGMA, Rendering
from rhizotwin.recon.tubes.tube_profiles import Sections

Array = NDArray[np.float64]

_SAMPLES = 9
"""Places across a tube."""
_FLANK_PX = 0.5
"""Beyond a tube's half-width what the tube explains ends."""


@dataclass(frozen=True)
class Proof:
    """Squared coverage, summed over the profiles across each node (N,) in all views, px."""

    explained: Array
    """By how much the squared difference between pictures and tubes grows where the node is left out."""
    left: Array
    """The squared difference that is left with it, where it covers."""
    alone: Array
    """Its own squared coverage: what it explains where nothing else does."""

    def of(self, nodes: NDArray[np.bool_]) -> Proof:
        """Return that of some of the nodes (N,)."""
        return Proof(self.explained[nodes], self.left[nodes], self.alone[nodes])


def find(drawn: Rendering) -> Proof:
    """Weigh what every node explains.

    With d the difference that is left, c the node's coverage and u the part that other tubes leave free of it, the
    difference without the node is d + u c: it explains (d + u c)^2 - d^2.

    Parameters
    ----------
    drawn : Rendering
        The tree.

    Returns
    -------
    Proof
        (N,) for each of its fields.
    """
    evidence, at = drawn.evidence, drawn.at
    cut = Sections.of(evidence, drawn.tubes, at)
    if cut is None:
        return Proof(*[np.zeros(at.shape[1])] * 3)
    per_px = dr.opaque(mi.Float, 1.0 / (float(np.hypot(evidence.blur_px, PIXEL_SIGMA)) * 2.0**0.5))
    explained, left, alone = (dr.zeros(mi.Float, cut.count) for _ in range(3))
    reach_px = cut.half_px + _FLANK_PX
    for k in range(_SAMPLES):
        o = cut.offset(k, _SAMPLES, reach_px)
        d, passing, told = cut.read(o, drawn.difference, drawn.passing, evidence.seen)
        c = sum(layer.height * 0.5 * (dr.erf((o + layer.half_px) * per_px) - dr.erf((o - layer.half_px) * per_px)) for layer in cut.layers)
        c = dr.minimum(c, FULLEST)
        own = c * dr.minimum(passing / (1 - c), 1.0)
        explained += own * (2.0 * d + own)
        left += dr.square(d)
        alone += dr.square(c) * told
    step = reach_px * (2.0 / (_SAMPLES - 1))
    totals = [cut.spread(total * step) for total in (explained, left, alone)]
    dr.eval(totals)  # together: they look at the same profiles
    return Proof(*(np.array(total, np.float64).reshape(cut.shape).sum(axis=0) for total in totals))
