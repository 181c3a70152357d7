"""Support of tube nodes: coverage that each node explains, and residual that remains."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.tubes.tube_picture import FULLEST, PIXEL_SIGMA, Rendering
from rhizotwin.recon.tubes.tube_sections import Sections

Array = NDArray[np.float64]

_SAMPLES = 9
"""Number of samples in a profile across a tube."""
_FLANK_PX = 0.5
"""Distance by which each profile extends beyond the edges of the tube, px."""


@dataclass(frozen=True)
class Support:
    """Support of each tube node (N,) by the pictures.

    All quantities are squared coverages that were integrated along profiles across the node and summed over all views,
    px.
    """

    explained: Array
    """Increase of the squared residual coverage if the node is removed, shape (N,), px."""
    residual: Array
    """Squared residual coverage in the pixels that the node covers, shape (N,), px."""
    own: Array
    """Squared coverage of the node itself, shape (N,), px. In the absence of other tubes, the node would explain this
    amount."""

    def select(self, nodes: NDArray[np.bool_]) -> Support:
        """Return the support of a subset of the nodes (N,)."""
        return Support(self.explained[nodes], self.residual[nodes], self.own[nodes])


def compute_support(drawn: Rendering) -> Support:
    """Compute the support of every node.

    Let d be the residual, c the coverage of the node, and u the fraction of a pixel that other tubes leave free.
    Without the node, the residual is d + u c. The node therefore explains (d + u c)^2 - d^2.

    Parameters
    ----------
    drawn : Rendering
        Rendering of the tree.

    Returns
    -------
    Support
        Support of the nodes. Each field has shape (N,).
    """
    evidence, at = drawn.evidence, drawn.at
    cut = Sections.cut(evidence, drawn.tubes, at)
    if cut is None:
        return Support(*[np.zeros(at.shape[1])] * 3)
    per_px = dr.opaque(mi.Float, 1.0 / (float(np.hypot(evidence.light.blur_px, PIXEL_SIGMA)) * 2.0**0.5))
    explained, left, alone = (dr.zeros(mi.Float, cut.count) for _ in range(3))
    reach_px = cut.half_px + _FLANK_PX
    for k in range(_SAMPLES):
        o = cut.offset(k, _SAMPLES, reach_px)
        d, passing, usable = cut.read(o, drawn.difference, drawn.passing, evidence.usable)
        c = sum(layer.height * 0.5 * (dr.erf((o + layer.half_px) * per_px) - dr.erf((o - layer.half_px) * per_px)) for layer in cut.layers)
        c = dr.minimum(c, FULLEST)
        own = c * dr.minimum(passing / (1 - c), 1.0)
        explained += own * (2.0 * d + own)
        left += dr.square(d)
        alone += dr.square(c) * usable
    step = reach_px * (2.0 / (_SAMPLES - 1))
    totals = [cut.spread(total * step) for total in (explained, left, alone)]
    dr.eval(totals)  # evaluated together, since they use the same profiles
    return Support(*(np.array(total, np.float64).reshape(cut.shape).sum(axis=0) for total in totals))
