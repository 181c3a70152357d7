"""Coverage pictures of tubes seen through the water, and how they change with the tubes (Dr.Jit).

A tube's segment is a strip in a picture: with its axis at distance d from a pixel's centre and half-width w it covers

    c = F(d + w) - F(d - w)

of the pixel, where F(x) is the part of the pixel on one side of a straight edge at distance x. For an edge in the direction (t_x, t_y) it
is the integral of a trapezoid, the convolution of two boxes of widths a = |t_x| and b = |t_y|: the square pixel seen along the edge.
Blur of standard deviation s makes them wider, a^2 + 6 s^2 and b^2 + 6 s^2 (exact in variance). Roots hide each other: coverages
combine as 1 - prod (1 - c), so that the optical depths t = -log(1 - c) add up. Along its axis a segment fades in and out at its ends,
so that the segments of a branch add up to a strip without seams.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields
from typing import Any, TypeVar

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from recon.coverage.evidence import Evidence, Nodes, bilinear
from recon.device import numbers, threads, wholes
from recon.tubes.translucent_tube import LAYERS, seen_from
from recon.tubes.tubes import Tubes

Array = NDArray[np.float64]
_T = TypeVar("_T")

PIXEL_SIGMA = 12.0**-0.5
"""Standard deviation of the square pixel."""
_MARGIN_PX = 2.0
_NARROWEST_PX = 0.1
_FAR_PX = 3.0
"""Beyond this from an edge a pixel lies on one side of it, blur and all."""
_FULLEST = 0.995
_PROFILE = 13
_PROFILE_MARGIN_PX = 1.8
_INTERPOLATION_VARIANCE = 0.1
"""Variance, px2, by which bilinear interpolation blurs."""
_LEAST_SPEED_PX = 0.3
"""A tube seen end-on (px/mm along its axis) shows no strip."""
OUTLIER = 0.05
"""Sum of squared differences over a profile, px, from which a view loses weight: something else is there.

Only what the tubes leave uncovered counts: that may be another root. What they cover and the picture shows empty is wrong for certain.
"""


def optical_depth(evidence: Evidence, tubes: Tubes, at: Nodes, blur_px: float) -> Any:
    """Return the optical depth of tubes in all views: mi.Float, (V, H, W) flattened."""
    (x, y, t_x, t_y, reach_px, half_a, half_b, *strips), (left, top, columns, rows), start = _all_strips(evidence, tubes, at)
    edges, heights = [(half_a, half_b)], None
    if strips:
        both_ends = list(zip(strips[::2], strips[1::2], strict=True))
        edges, heights = both_ends[:LAYERS], both_ends[LAYERS:]
    pixels, width = columns * rows, evidence.image_wh[0]
    depth = dr.zeros(mi.Float, evidence.bank.count * evidence.pixels)
    dr.eval(depth)
    # opaque: as a literal every blur would be a kernel of its own
    scale, spread = dr.opaque(mi.Float, 1.0 / (float(np.hypot(blur_px, PIXEL_SIGMA)) * 2.0**0.5)), dr.opaque(mi.Float, 6.0 * blur_px**2)
    box_a, box_b = (dr.maximum(dr.sqrt(dr.square(t) + spread), _NARROWEST_PX) for t in (t_x, t_y))
    outer, inner = 0.5 * (box_a + box_b), 0.5 * dr.abs(box_a - box_b)

    def side(x: Any) -> Any:
        """Return the part of a pixel that lies on one side of an edge."""
        x = dr.clip(x, -_FAR_PX, _FAR_PX)
        ramps = [dr.square(dr.maximum(x + shift, 0.0)) for shift in (outer, inner, -inner, -outer)]
        return 0.5 * (ramps[0] - ramps[1] - ramps[2] + ramps[3]) / (box_a * box_b)

    def body(k: Any, i: Any, j: Any) -> tuple[Any, Any, Any]:
        u, v = left + i, top + j
        e_x, e_y = mi.Float(u) - x, mi.Float(v) - y
        s, d = e_x * t_x + e_y * t_y, e_y * t_x - e_x * t_y  # along the segment, across it
        part = dr.clip(s / reach_px, 0, 1)
        c = mi.Float(0.0)
        for n, (w_a, w_b) in enumerate(edges):
            w = w_a + (w_b - w_a) * part
            layer = side(d + w) - side(d - w)
            c += layer if heights is None else layer * (heights[n][0] + (heights[n][1] - heights[n][0]) * part)
        gate = 0.5 * (dr.erf(s * scale) - dr.erf((s - reach_px) * scale))
        value = -gate * dr.log(1 - dr.minimum(c, _FULLEST))
        dr.scatter_reduce(dr.ReduceOp.Add, depth, value, start + v * width + u, value > 1e-4)
        last = i + 1 == columns
        return k + 1, dr.select(last, 0, i + 1), dr.select(last, j + 1, j)

    begin = tuple(dr.zeros(mi.UInt32, dr.width(left)) for _ in range(3))
    dr.while_loop(begin, lambda k, *_: k < pixels, body)
    dr.eval(depth)
    return depth


def _all_strips(evidence: Evidence, tubes: Tubes, at: Nodes) -> tuple[list[Any], list[Any], Any]:
    """Return the strips that are drawn, those of one view after those of another.

    Returns
    -------
    real, whole : as `_strips` has them, mi.Float and mi.UInt32.
    start : where the picture of each strip's view begins, mi.UInt32.
    """
    segments, radii = tubes.segments.T, tubes.segment_radii
    views = _each_view(lambda view: _strips(evidence, tubes.centre_mm, segments, radii, at.view(view)), evidence.bank.count)
    real, whole = ([np.concatenate(parts) for parts in zip(*kind, strict=True)] for kind in zip(*views, strict=True))
    start = np.repeat(np.arange(len(views)) * evidence.pixels, [len(whole_of_view[0]) for _, whole_of_view in views])
    return [numbers(values) for values in real], [wholes(values) for values in whole], wholes(start)


def _strips(
    evidence: Evidence, centre_mm: Array, segments: NDArray[np.int64], radii: tuple[Array, Array], at: Nodes
) -> tuple[list[Array], list[Array]]:
    """Return the strips (M,) that segments (2, S) are in one view.

    Returns
    -------
    real : column and row of the beginning, direction (2), length, half-widths at both ends; of translucent roots also the half-widths of
        each layer at both ends, and the heights.
    whole : left and top, columns and rows of the pixels to look at.
    """
    a, b = segments
    first, second = ([np.ascontiguousarray(at.px[..., axis])[:, end] for axis in range(2)] for end in (a, b))
    t_u, t_v = (there - here for here, there in zip(first, second, strict=True))
    length = np.sqrt(t_u * t_u + t_v * t_v)
    t_u /= np.maximum(length, 1e-6)
    t_v /= np.maximum(length, 1e-6)
    column, row, both = (np.einsum("vni,vni->vn", p, q) for p, q in ((at.du, at.du), (at.dv, at.dv), (at.du, at.dv)))
    uu, vv, uv = t_u * t_u, t_v * t_v, 2.0 * t_u * t_v
    half = [  # across the segment the scale is that of t_u dv - t_v du
        radius_mm * np.sqrt(np.maximum(uu * row[:, end] + vv * column[:, end] - uv * both[:, end], 0.0))
        for radius_mm, end in zip(radii, (a, b), strict=True)
    ]
    reach = np.maximum(*half) + _MARGIN_PX
    low, span = [], []
    for here, there, limit in zip(first, second, evidence.image_wh, strict=True):
        low.append(np.clip(np.floor(np.minimum(here, there) - reach), 0, limit - 1))
        span.append(np.clip(np.ceil(np.maximum(here, there) + reach), 0, limit - 1) - low[-1] + 1)
    real = [*first, t_u, t_v, length, *half]
    if evidence.mu_per_mm is not None:
        way = centre_mm[b] - centre_mm[a]
        way /= np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-12)
        ends = [seen_from(evidence.mu_per_mm, radius_mm, at.sine(way, end)) for radius_mm, end in zip(radii, (a, b), strict=True)]
        real += [w * strip.width[n] for n in range(LAYERS) for w, strip in zip(half, ends, strict=True)]
        real += [strip.height[n] for n in range(LAYERS) for strip in ends]
    drawn = at.seen[:, a] & at.seen[:, b] & (length > 1e-3)
    return [values[drawn] for values in real], [values[drawn] for values in (*low, *span)]


def unexplained(evidence: Evidence, depth: Any) -> Any:
    """Return measured less explained coverage in all views, 0 where nothing is seen: mi.Float, flattened."""
    difference = (evidence.coverage - (1 - dr.exp(-depth))) * evidence.seen
    dr.eval(difference)
    return difference


@dataclass(frozen=True)
class Pull:
    """What the pictures want of each node: the normal equations of position and radius, H x = g."""

    hessian: Array
    """(N, 4, 4) of x, y, z, radius."""
    gradient: Array
    """(N, 4)"""
    visible: Array
    """(N,) share of the nodes' coverage, summed over the views, that nothing hides."""
    views: Array
    """(N,) views in which most of the node is visible."""
    wish: Array
    """(V, N) each view's part of the radius's gradient."""


@dataclass(frozen=True)
class Profiles:
    """What each view (V) says across the tube at each node (N), integrated over its profile."""

    across: Array
    """(V, N, 3) gradient of the place across the tube by the node, px/mm."""
    scale: Array
    """(V, N) px/mm across the tube."""
    shift_2: Array
    """(V, N) squared derivative of the coverage by a shift in px; 0 where the view says nothing."""
    shift_width: Array
    width_2: Array
    shift: Array
    """(V, N) derivative by the shift times what is unexplained."""
    width: Array
    shown: Array
    """(V, N) coverage that nothing hides."""
    whole: Array

    def of(self, nodes: NDArray[np.int64]) -> Profiles:
        """Return the profiles of some nodes."""
        return Profiles(*(getattr(self, field.name)[:, nodes] for field in fields(self)))

    def pull(self) -> Pull:
        """Return the normal equations of all views together."""
        count, scale = self.scale.shape[1], self.scale
        hessian, gradient = np.zeros((count, 4, 4)), np.zeros((count, 4))
        hessian[:, :3, :3] = np.einsum("vn,vni,vnj->nij", self.shift_2, self.across, self.across)
        hessian[:, :3, 3] = hessian[:, 3, :3] = np.einsum("vn,vni->ni", self.shift_width * scale, self.across)
        hessian[:, 3, 3] = (self.width_2 * scale**2).sum(axis=0)
        gradient[:, :3] = np.einsum("vn,vni->ni", self.shift, self.across)
        gradient[:, 3] = (self.width * scale).sum(axis=0)
        visible = self.shown.sum(axis=0) / np.maximum(self.whole.sum(axis=0), 1e-9)
        views = (self.shown > 0.5 * np.maximum(self.whole, 1e-9)).sum(axis=0).astype(np.float64)
        return Pull(hessian, gradient, visible, views, self.width * scale)


def pull(evidence: Evidence, tubes: Tubes, at: Nodes, depth: Any, difference: Any, blur_px: float) -> Pull:
    """Compare pictures and tubes across every node in every view, all views together."""
    return profiles(evidence, tubes, at, depth, difference, blur_px).pull()


def misfit(evidence: Evidence, tubes: Tubes, difference: Any) -> Array:
    """Return the squared difference (V, N), px, integrated over the profile across every node; not a number where a view has none."""
    at = evidence.project(tubes.centre_mm)
    _, normal, scale, used = sections(tubes, at)

    def number(values: Array) -> Any:
        return numbers(values[used])

    u, v, n_u, n_v, w = (number(part) for part in (at.px[..., 0], at.px[..., 1], normal[..., 0], normal[..., 1], tubes.radius_mm * scale))
    start = wholes(np.broadcast_to(np.arange(len(at.px))[:, None] * evidence.pixels, used.shape)[used])
    columns, rows = evidence.image_wh
    total, reach = dr.zeros(mi.Float, int(used.sum())), w + _PROFILE_MARGIN_PX
    for k in range(_PROFILE):
        o = reach * ((2 * k - (_PROFILE - 1)) / (_PROFILE - 1))
        total += dr.square(
            bilinear(difference, start, columns, dr.clip(u + n_u * o, 0.0, columns - 1.01), dr.clip(v + n_v * o, 0.0, rows - 1.01))
        )
    whole = np.full(used.shape, np.nan)
    whole[used] = np.array(total * reach * (2.0 / (_PROFILE - 1)))
    return whole


def sections(tubes: Tubes, at: Nodes) -> tuple[Array, Array, Array, NDArray[np.bool_]]:
    """Cut across every node in every view.

    Returns
    -------
    across : (V, N, 3) gradient of the place across the tube by the node (canister frame), px/mm.
    normal : (V, N, 2) unit direction across the tube in the picture, column and row.
    scale : (V, N) px/mm across the tube.
    used : (V, N) whether the node is seen, and not end-on.
    """
    tangent, shape = tubes.tangents, at.seen.shape
    across, normal, scale, used = np.empty((*shape, 3)), np.empty((*shape, 2)), np.empty(shape), np.empty(shape, np.bool_)

    def cut(view: int) -> None:
        t_u, t_v = (np.einsum("ni,ni->n", slope[view], tangent) for slope in (at.du, at.dv))
        speed = np.hypot(t_u, t_v)
        normal[view] = np.stack([-t_v, t_u], axis=-1) / np.maximum(speed, 1e-6)[:, None]
        across[view] = at.view(view).across(normal[view])[0]
        scale[view] = np.sqrt(np.einsum("ni,ni->n", across[view], across[view]))
        used[view] = at.seen[view] & (speed > _LEAST_SPEED_PX)

    _each_view(cut, shape[0])
    return across, normal, scale, used


def _each_view(work: Callable[[int], _T], views: int) -> list[_T]:
    """Return what some work gives for each view; one by one, since a view's arrays stay in the processor's cache."""
    with ThreadPoolExecutor(max_workers=threads()) as pool:
        return list(pool.map(work, range(views)))


def profiles(evidence: Evidence, tubes: Tubes, at: Nodes, depth: Any, difference: Any, blur_px: float) -> Profiles:
    """Compare pictures and tubes across every node in every view.

    In a profile across the tube at offsets o the coverage changes with its shift by -(g(o + w) - g(o - w)) v and with its half-width
    by (g(o + w) + g(o - w)) v, where g is the Gaussian of the pixel and v the share that other tubes leave visible.
    """
    across, normal, scale, used = sections(tubes, at)
    half_px = tubes.radius_mm * scale
    layers = None if evidence.mu_per_mm is None else _Layer.of_all(evidence.mu_per_mm, tubes, at, half_px, used)
    return Profiles(across, scale, *_profiles(evidence, at.px, normal, half_px, layers, used, depth, difference, blur_px))


@dataclass(frozen=True)
class _Layer:
    """A strip of translucent roots across the profiles, all mi.Float."""

    half_px: Any
    height: Any
    by_width: Any
    """Derivative of the coverage by the root's half-width over that by the strip's own."""
    by_height: Any
    """Derivative of the height by the root's half-width, 1/px."""

    @staticmethod
    def of_all(mu_per_mm: float, tubes: Tubes, at: Nodes, half_px: Array, used: NDArray[np.bool_]) -> list[_Layer]:
        """Return the layers of all profiles that are used (V, N)."""
        tangent = tubes.tangents

        def of_view(view: int) -> Array:
            strips, w = seen_from(mu_per_mm, tubes.radius_mm, at.view(view).sine(tangent)), half_px[view]
            e, h = strips.width[:, 0], strips.height[:, 0]
            parts = w * e, h, h * (e + strips.width_slope[:, 0]), strips.height_slope[:, 0] / w
            return np.stack(parts)[..., used[view]]

        fields = np.concatenate(_each_view(of_view, len(used)), axis=-1)  # (4, LAYERS, M)
        return [_Layer(*(numbers(part[layer]) for part in fields)) for layer in range(LAYERS)]


def _profiles(
    evidence: Evidence,
    px: Array,
    normal: Array,
    half_px: Array,
    layers: list[_Layer] | None,
    used: NDArray[np.bool_],
    depth: Any,
    difference: Any,
    blur_px: float,
) -> list[Array]:
    """Integrate over the profiles (V, N): shift^2, shift * width, width^2, both times the difference, coverage shown and whole."""

    def number(values: Array) -> Any:
        return numbers(values[used])

    u, v, n_u, n_v, w = number(px[..., 0]), number(px[..., 1]), number(normal[..., 0]), number(normal[..., 1]), number(half_px)
    base = np.broadcast_to(np.arange(len(px))[:, None] * evidence.pixels, used.shape)[used]
    start = wholes(base)
    columns, rows = evidence.image_wh
    sigma = float(np.sqrt(blur_px**2 + PIXEL_SIGMA**2 + _INTERPOLATION_VARIANCE))
    scale, peak = (dr.opaque(mi.Float, 1.0 / (sigma * root)) for root in (2.0**0.5, (2.0 * np.pi) ** 0.5))

    def across(o: Any, w: Any) -> tuple[Any, Any, Any]:
        """Return a strip's coverage at an offset, and its derivatives by shift and half-width."""
        g_plus, g_minus = (peak * dr.exp(-dr.square((o + side * w) * scale)) for side in (1.0, -1.0))
        return 0.5 * (dr.erf((o + w) * scale) - dr.erf((o - w) * scale)), g_minus - g_plus, g_plus + g_minus

    sums = [dr.zeros(mi.Float, len(base)) for _ in range(8)]
    reach = w + _PROFILE_MARGIN_PX
    for k in range(_PROFILE):
        o = reach * ((2 * k - (_PROFILE - 1)) / (_PROFILE - 1))
        at = dr.clip(u + n_u * o, 0.0, columns - 1.01), dr.clip(v + n_v * o, 0.0, rows - 1.01)
        d, t = (bilinear(source, start, columns, *at) for source in (difference, depth))
        if layers is None:
            c, shift, width = across(o, w)
        else:
            c, shift, width = mi.Float(0.0), mi.Float(0.0), mi.Float(0.0)
            for layer in layers:
                box, box_shift, box_width = across(o, layer.half_px)
                c += layer.height * box
                shift += layer.height * box_shift
                width += layer.by_width * box_width + layer.by_height * box
        c = dr.minimum(c, _FULLEST)
        visible = dr.exp(-dr.maximum(t + dr.log(1 - c), 0.0))
        shift, width = shift * visible, width * visible
        terms = (shift * shift, shift * width, width * width, shift * d, width * d, visible * c, c, dr.square(dr.maximum(d, 0.0)))
        sums = [total + term for total, term in zip(sums, terms, strict=True)]
    step = reach * (2.0 / (_PROFILE - 1))
    weight = step / (1.0 + sums.pop() * step / OUTLIER)
    scattered = []
    sums = [total * factor for total, factor in zip(sums, [weight] * 5 + [step] * 2, strict=True)]
    dr.eval(sums)  # one by one, each would look at all profiles anew
    for total in sums:
        whole = np.zeros(used.shape)
        whole[used] = np.array(total)
        scattered.append(whole)
    return scattered
