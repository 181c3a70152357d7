"""What each part of the tubes explains of the pictures, and what it leaves: the evidence that a root is there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from recon.coverage.evidence import Evidence, Nodes, bilinear
from recon.device import numbers, wholes
from recon.tubes import tube_picture
from recon.tubes.translucent_tube import seen_from
from recon.tubes.tubes import Tubes

Array = NDArray[np.float64]

_PROFILE = 9
_FLANK_PX = 0.5


@dataclass(frozen=True)
class Proof:
    """Squared coverage, summed over the profiles across each node (N,) in all views, px."""

    explained: Array
    """By how much the squared difference between pictures and tubes grows where the node is left out."""
    left: Array
    """The squared difference that is left with it, where it covers."""

    def of(self, nodes: NDArray[np.bool_]) -> Proof:
        """Return that of some of the nodes."""
        return Proof(self.explained[nodes], self.left[nodes])


def weigh(evidence: Evidence, tubes: Tubes, at: Nodes, depth: Any, difference: Any, blur_px: float) -> Proof:
    """Weigh what every node explains.

    With d the difference that is left, c the node's coverage and u the part that other tubes leave free of it, the difference without
    the node is d + u c: it explains (d + u c)^2 - d^2.
    """
    _, normal, scale, used = tube_picture.sections(tubes, at)
    half_px = tubes.radius_mm * scale

    def number(values: Array) -> Any:
        return numbers(values[used])

    u, v, n_u, n_v, w = number(at.px[..., 0]), number(at.px[..., 1]), number(normal[..., 0]), number(normal[..., 1]), number(half_px)
    layers = [(1.0, w)]
    if evidence.mu_per_mm is not None:
        strips = seen_from(evidence.mu_per_mm, tubes.radius_mm, at.sine(tubes.tangents))
        layers = [(number(h), number(e * half_px)) for h, e in zip(strips.height, strips.width, strict=True)]
    base = np.broadcast_to(np.arange(len(at.px))[:, None] * evidence.pixels, used.shape)[used]
    start = wholes(base)
    columns, rows = evidence.image_wh
    sigma = float(np.hypot(blur_px, tube_picture.PIXEL_SIGMA))
    per_px = 1.0 / (sigma * np.sqrt(2.0))
    explained, left = dr.zeros(mi.Float, len(base)), dr.zeros(mi.Float, len(base))
    reach = w + _FLANK_PX
    for k in range(_PROFILE):
        o = reach * ((2 * k - (_PROFILE - 1)) / (_PROFILE - 1))
        px = dr.clip(u + n_u * o, 0.0, columns - 1.01), dr.clip(v + n_v * o, 0.0, rows - 1.01)
        d, t = (bilinear(source, start, columns, *px) for source in (difference, depth))
        c = dr.minimum(sum(h * 0.5 * (dr.erf((o + a) * per_px) - dr.erf((o - a) * per_px)) for h, a in layers), 0.995)
        own = c * dr.exp(-dr.maximum(t + dr.log(1 - c), 0.0))
        explained += own * (2.0 * d + own)
        left += dr.square(d)
    step = reach * (2.0 / (_PROFILE - 1))
    sums = []
    totals = explained * step, left * step
    dr.eval(totals)  # together: they look at the same profiles
    for total in totals:
        whole = np.zeros(used.shape)
        whole[used] = np.array(total)
        sums.append(whole.sum(axis=0))
    return Proof(sums[0], sums[1])
