"""Coverage pictures of tubes seen through the water (Dr.Jit).

A tube's segment is a strip in a picture: with its axis at distance d from a pixel's centre and half-width w it covers

    c = F(d + w) - F(d - w)

of the pixel, where F(x) is the part of the pixel on one side of a straight edge at distance x. For an edge in the direction (t_x, t_y) it
is the integral of a trapezoid, the convolution of two boxes of widths a = |t_x| and b = |t_y|: the square pixel seen along the edge.
Blur of standard deviation s makes them wider, a^2 + 6 s^2 and b^2 + 6 s^2 (exact in variance). Roots hide each other: coverages
combine as 1 - prod (1 - c), so that the optical depths t = -log(1 - c) add up. Along its axis a segment fades in and out at its ends,
so that the segments of a branch add up to a strip without seams.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from recon.coverage.evidence import Evidence, Nodes
from recon.device import numbers, vectors, wholes
from recon.tubes import translucent_tube
from recon.tubes.translucent_tube import Layer
from recon.tubes.tubes import Tubes

PIXEL_SIGMA = 12.0**-0.5
"""Standard deviation of the square pixel."""
_MARGIN_PX = 2.0
_NARROWEST_PX = 0.1
_FAR_PX = 3.0
"""Beyond this from an edge a pixel lies on one side of it, blur and all."""
FULLEST = 0.995


def optical_depth(evidence: Evidence, tubes: Tubes, at: Nodes, blur_px: float) -> Any:
    """Return the optical depth of tubes in all views: mi.Float, (V, H, W) flattened."""
    depth = dr.zeros(mi.Float, evidence.bank.count * evidence.pixels)
    dr.eval(depth)
    strips = _Strips.of(evidence, tubes, at)
    if strips is None:
        return depth
    (left, top), (columns, rows), (t_x, t_y) = strips.low, strips.span, strips.way
    pixels, width = columns * rows, evidence.image_wh[0]
    # opaque: as a literal every blur would be a kernel of its own
    scale, spread = dr.opaque(mi.Float, 1.0 / (float(np.hypot(blur_px, PIXEL_SIGMA)) * 2.0**0.5)), dr.opaque(mi.Float, 6.0 * blur_px**2)
    box_a, box_b = (dr.maximum(dr.sqrt(dr.square(t) + spread), _NARROWEST_PX) for t in (t_x, t_y))
    outer, inner, per_area = 0.5 * (box_a + box_b), 0.5 * dr.abs(box_a - box_b), 0.5 / (box_a * box_b)

    def side(x: Any) -> Any:
        """Return the part of a pixel that lies on one side of an edge."""
        x = dr.clip(x, -_FAR_PX, _FAR_PX)
        ramps = [dr.square(dr.maximum(x + shift, 0.0)) for shift in (outer, inner, -inner, -outer)]
        return (ramps[0] - ramps[1] - ramps[2] + ramps[3]) * per_area

    def body(k: Any, i: Any, j: Any) -> tuple[Any, Any, Any]:
        u, v = left + i, top + j
        e_x, e_y = mi.Float(u) - strips.begin.x, mi.Float(v) - strips.begin.y
        s, d = e_x * t_x + e_y * t_y, e_y * t_x - e_x * t_y  # along the segment, across it
        part = dr.clip(s / strips.length, 0, 1)
        c = mi.Float(0.0)
        for a, b in zip(*strips.layers, strict=True):
            w = a.half_px + (b.half_px - a.half_px) * part
            c += (side(d + w) - side(d - w)) * (a.height + (b.height - a.height) * part)
        gate = 0.5 * (dr.erf(s * scale) - dr.erf((s - strips.length) * scale))
        value = -gate * dr.log(1 - dr.minimum(c, FULLEST))
        dr.scatter_reduce(dr.ReduceOp.Add, depth, value, strips.start + v * width + u, value > 1e-4)
        last = i + 1 == columns
        return k + 1, dr.select(last, 0, i + 1), dr.select(last, j + 1, j)

    begin = tuple(dr.zeros(mi.UInt32, dr.width(left)) for _ in range(3))
    dr.while_loop(begin, lambda k, *_: k < pixels, body)
    dr.eval(depth)
    return depth


@dataclass(frozen=True)
class _Strips:
    """Segments of tubes in the views that see both their ends, (M,) on the device."""

    start: Any
    """mi.UInt32, where the picture of the view begins."""
    low: tuple[Any, Any]
    """Column and row of the first pixel to look at, mi.UInt32, and ..."""
    span: tuple[Any, Any]
    """... how many."""
    begin: Any
    """mi.Vector2f, pixel of the beginning."""
    way: Any
    """mi.Vector2f, unit direction."""
    length: Any
    """mi.Float, px."""
    layers: tuple[list[Layer], list[Layer]]
    """The strips as which it is seen, at both ends."""

    @staticmethod
    def of(evidence: Evidence, tubes: Tubes, at: Nodes) -> _Strips | None:
        """Return the strips of all views; None where no view sees any."""
        p, (views, nodes), segments = at.on_device, at.shape, tubes.segments
        count, nodes = dr.opaque(mi.UInt32, len(segments)), dr.opaque(mi.UInt32, nodes)
        numbered = [wholes(end) for end in segments.T]

        def ends(place: Any) -> tuple[Any, Any, list[Any]]:
            """Return views, segments and the places of both ends in (V, N), flattened."""
            view = place // count
            segment = place - view * count
            return view, segment, [view * nodes + dr.gather(mi.UInt32, end, segment) for end in numbered]

        _, _, both = ends(dr.arange(mi.UInt32, views * len(segments)))
        seen = [dr.gather(mi.Bool, p.seen, end) for end in both]
        here, there = (dr.gather(mi.Vector2f, p.px, end) for end in both)
        drawn = dr.compress(seen[0] & seen[1] & (dr.norm(there - here) > 1e-3))
        if not dr.width(drawn):
            return None
        view, segment, both = ends(drawn)
        here, there = (dr.gather(mi.Vector2f, p.px, end) for end in both)
        length = dr.norm(there - here)
        way = (there - here) / length
        along = vectors(tubes.centre_mm[segments[:, 1]] - tubes.centre_mm[segments[:, 0]])
        along = dr.normalize(dr.gather(mi.Vector3f, along, segment))
        layers, half_px = [], []
        for end, radii in zip(both, tubes.segment_radii, strict=True):
            du, dv = (dr.gather(mi.Vector3f, part, end) for part in (p.du, p.dv))
            radius_mm = dr.gather(mi.Float, numbers(radii), segment)
            half_px.append(radius_mm * dr.norm(way.x * dv - way.y * du))  # across the segment
            layers.append(translucent_tube.layers(evidence.mu_per_mm, radius_mm, translucent_tube.sine(du, dv, along), half_px[-1]))
        reach = dr.maximum(*half_px) + _MARGIN_PX
        low, span = [], []
        for a, b, limit in zip(here, there, evidence.image_wh, strict=True):
            low.append(mi.UInt32(dr.clip(dr.floor(dr.minimum(a, b) - reach), 0, limit - 1)))
            span.append(mi.UInt32(dr.clip(dr.ceil(dr.maximum(a, b) + reach), 0, limit - 1)) - low[-1] + 1)
        start = view * dr.opaque(mi.UInt32, evidence.pixels)
        return _Strips(start, (low[0], low[1]), (span[0], span[1]), here, way, length, (layers[0], layers[1]))


def unexplained(evidence: Evidence, depth: Any) -> Any:
    """Return measured less explained coverage in all views, 0 where nothing is seen: mi.Float, flattened."""
    difference = (evidence.coverage - (1 - dr.exp(-depth))) * evidence.seen
    dr.eval(difference)
    return difference
