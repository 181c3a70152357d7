"""What each view says across the tubes at every node.

Coverage along a profile, and how it would change with the node (Dr.Jit).

In a profile across a tube at offsets o the coverage changes with its shift by -(g(o + w) - g(o - w)) v and with its
half-width w by (g(o + w) + g(o - w)) v, where g is the Gaussian of the pixel and v the share that other tubes leave
visible.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.coverage.evidence import Evidence, Nodes, sine_to_sight
from rhizotwin.recon.device import TO_LAST, Float, Kernel, UInt32, Vector2f, Vector3f, bilinear, numbers, vectors, wholes
from rhizotwin.recon.tubes import translucent_tube
from rhizotwin.recon.tubes.translucent_tube import Layer
from rhizotwin.recon.tubes.tube_picture import FULLEST, PIXEL_SIGMA
from rhizotwin.recon.tubes.tubes import Tubes

Array = NDArray[np.float64]

_SAMPLES = 14
"""Samples of a profile, half of them at either edge."""
_MARGIN_PX = 1.8
"""A profile is compared so far to both sides of either edge, or to the middle: nothing else tells of shift and
width."""
_INTERPOLATION_VARIANCE = 0.1
"""Variance, px2, by which bilinear interpolation blurs."""
_LEAST_SPEED_PX = 0.3
"""A tube seen end-on (px/mm along its axis) shows no strip."""
OUTLIER = 0.05
"""Sum of squared differences over a profile, px, from which a view loses weight: something else is there.

Only what the tubes leave uncovered counts: that may be another root. What they cover and the picture shows empty is
wrong for certain.
"""


@dataclass(frozen=True)
class Sections:
    """Cuts across nodes in the views that see them and not end-on; (M,) on the device."""

    shape: tuple[int, int]
    """Views and nodes, V and N."""
    place: UInt32
    """mi.UInt32, which of (V, N), flattened, each is."""
    start: UInt32
    """mi.UInt32, where the picture of its view begins."""
    columns: int
    rows: int
    px: Vector2f
    """mi.Vector2f, the node's pixel."""
    normal: Vector2f
    """mi.Vector2f, unit direction across the tube in the picture."""
    across: Vector3f
    """mi.Vector3f, gradient of the place across the tube by the node (canister frame), px/mm."""
    scale: Float
    """mi.Float, px/mm across the tube."""
    half_px: Float
    """mi.Float, half-width of the tube."""
    layers: list[Layer]
    """The strips as which the tube is seen."""

    @staticmethod
    def of(evidence: Evidence, tubes: Tubes, at: Nodes) -> Sections | None:
        """Cut across the nodes of tubes; None where no view shows any."""
        p, count = at.on_device, dr.opaque(mi.UInt32, at.shape[1])
        tangent = vectors(tubes.tangents)
        t = at.in_all_views(tangent)
        place = dr.compress(p.seen & (dr.square(dr.dot(p.du, t)) + dr.square(dr.dot(p.dv, t)) > _LEAST_SPEED_PX**2))
        if not dr.width(place):
            return None
        view = place // count
        node = place - view * count
        px, du, dv = dr.gather(mi.Vector2f, p.px, place), dr.gather(mi.Vector3f, p.du, place), dr.gather(mi.Vector3f, p.dv, place)
        t, radius_mm = dr.gather(mi.Vector3f, tangent, node), dr.gather(mi.Float, numbers(tubes.radius_mm), node)
        normal = dr.normalize(mi.Vector2f(-dr.dot(dv, t), dr.dot(du, t)))
        across = normal.x * du + normal.y * dv
        scale = dr.norm(across)
        half_px = radius_mm * scale
        layers = translucent_tube.layers(evidence.mu_per_mm, evidence.hairs, radius_mm, sine_to_sight(du, dv, t), half_px)
        start = view * dr.opaque(mi.UInt32, evidence.pixels)
        return Sections(at.shape, place, start, *evidence.image_wh, px, normal, across, scale, half_px, layers)

    @property
    def count(self) -> int:
        """Return how many there are."""
        return int(dr.width(self.place))

    def offset(self, k: UInt32, samples: int, reach_px: Float) -> Float:
        """Return the offset across the tube, px, of one of a profile's samples, from ``-reach_px`` to ``reach_px``."""
        return reach_px * ((2.0 * mi.Float(k) - (samples - 1)) / (samples - 1))

    def at_edge(self, k: UInt32 | int) -> Float:
        """Return the offset across the tube, px, of one of `_SAMPLES` samples about its two edges.

        They are `edge_step` apart.
        """
        number, half = mi.Float(k), _SAMPLES // 2
        first = number < half
        inward = dr.select(first, number, number - half) + 0.5
        return dr.select(first, -1.0, 1.0) * (self.half_px + _MARGIN_PX - inward * self.edge_step)

    @property
    def edge_step(self) -> Float:
        """Return how far apart the samples about an edge are, mi.Float, px."""
        return (dr.minimum(self.half_px, _MARGIN_PX) + _MARGIN_PX) * (2.0 / _SAMPLES)

    def read(self, offset_px: Float, *pictures: Float) -> list[Float]:
        """Interpolate pictures of all views, flattened, at an offset across the tube."""
        u = dr.clip(self.px.x + self.normal.x * offset_px, 0.0, self.columns - TO_LAST)
        v = dr.clip(self.px.y + self.normal.y * offset_px, 0.0, self.rows - TO_LAST)
        return [bilinear(picture, self.start, self.columns, u, v) for picture in pictures]

    def spread(self, value: Float) -> Float:
        """Return values (M,) in their places, mi.Float (V, N) flattened; 0 where nothing is cut."""
        whole = dr.zeros(mi.Float, self.shape[0] * self.shape[1])
        dr.scatter(whole, value, self.place)
        return whole


@dataclass(frozen=True)
class ResidualGradient:
    """What the pictures want of each node: the normal equations of position and radius, H x = g."""

    hessian: Array
    """(N, 4, 4) of x, y, z, radius."""
    gradient: Array
    """(N, 4)"""
    visible: Array
    """(N,) share of the nodes' coverage, summed over the views, that nothing hides."""

    def of(self, nodes: NDArray[np.int64]) -> ResidualGradient:
        """Return that of some nodes (M,)."""
        return ResidualGradient(*(getattr(self, field.name)[nodes] for field in fields(self)))


@dataclass(frozen=True)
class HostProfiles:
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


@dataclass(frozen=True)
class Profiles:
    """`HostProfiles` on the device, (V, N) flattened."""

    shape: tuple[int, int]
    across: Vector3f
    """mi.Vector3f; all others mi.Float."""
    scale: Float
    shift_2: Float
    shift_width: Float
    width_2: Float
    shift: Float
    width: Float
    shown: Float
    whole: Float

    def host(self, nodes: NDArray[np.int64] | None = None) -> HostProfiles:
        """Return them, or those of some nodes (M,), as NumPy has them."""
        views, count = self.shape
        chosen = np.arange(count) if nodes is None else nodes
        place = wholes(np.arange(views)[:, None] * count + chosen)

        def read(part: Float) -> Array:
            return np.array(dr.gather(mi.Float, part, place), np.float64).reshape(views, len(chosen))

        return HostProfiles(
            np.stack([read(part) for part in self.across], axis=-1), *(read(getattr(self, field.name)) for field in fields(self)[2:])
        )

    def residual_gradient(self) -> ResidualGradient:
        """Return the normal equations of all views together."""
        views, count = self.shape
        nodes = dr.opaque(mi.UInt32, count)

        def terms(at: UInt32) -> Iterator[Float]:
            """Give what a view adds: position by position (upper triangle), by radius, gradient, coverage."""
            parts = [dr.gather(mi.Float, part, at) for part in self.across]
            scale, shift_2, shift_width, width_2, shift, width, shown, whole = (
                dr.gather(mi.Float, getattr(self, field.name), at) for field in fields(self)[2:]
            )
            yield from (shift_2 * parts[i] * parts[j] for i in range(3) for j in range(i, 3))
            yield from (shift_width * scale * part for part in parts)
            yield width_2 * dr.square(scale)
            yield from (shift * part for part in parts)
            yield width * scale
            yield from (shown, whole)

        def body(view: UInt32, at: UInt32, *sums: Float) -> tuple[Kernel, ...]:
            return view + 1, at + nodes, *(total + term for total, term in zip(sums, terms(at), strict=True))

        begin = dr.zeros(mi.UInt32, count), dr.arange(mi.UInt32, count), *(dr.zeros(mi.Float, count) for _ in range(16))
        sums = dr.while_loop(begin, lambda view, *_: view < views, body)[2:]
        dr.eval(sums)
        found = np.stack([np.array(total, np.float64) for total in sums], axis=-1)
        hessian = np.empty((count, 4, 4))
        row, column = np.array([0, 0, 0, 1, 1, 2, 0, 1, 2, 3]), np.array([0, 1, 2, 1, 2, 2, 3, 3, 3, 3])
        hessian[:, row, column] = hessian[:, column, row] = found[:, :10]
        shown, whole = found[:, 14:].T
        return ResidualGradient(hessian, found[:, 10:14], shown / np.maximum(whole, 1e-9))


def profiles(evidence: Evidence, tubes: Tubes, at: Nodes, depth: Float, difference: Float, blur_px: float) -> Profiles:
    """Compare pictures and tubes across every node in every view.

    Parameters
    ----------
    at : Nodes
        Where the nodes lie.
    depth, difference : Float
        As `tube_picture.optical_depth` and `tube_picture.unexplained` have them.
    """
    cut = Sections.of(evidence, tubes, at)
    if cut is None:
        empty = dr.zeros(mi.Float, at.shape[0] * at.shape[1])
        return Profiles(at.shape, mi.Vector3f(empty, empty, empty), *[empty] * 8)
    sigma = float(np.sqrt(blur_px**2 + PIXEL_SIGMA**2 + _INTERPOLATION_VARIANCE))
    per_px, peak = (dr.opaque(mi.Float, 1.0 / (sigma * root)) for root in (2.0**0.5, (2.0 * np.pi) ** 0.5))

    def body(k: UInt32, *sums: Float) -> tuple[Kernel, ...]:
        o = cut.at_edge(k)
        d, t = cut.read(o, difference, depth)
        c, shift, width = mi.Float(0.0), mi.Float(0.0), mi.Float(0.0)
        for layer in cut.layers:
            plus, minus = (o + layer.half_px) * per_px, (o - layer.half_px) * per_px
            g_plus, g_minus = (peak * dr.exp(-dr.square(edge)) for edge in (plus, minus))
            box = 0.5 * (dr.erf(plus) - dr.erf(minus))
            c += layer.height * box
            shift += layer.height * (g_minus - g_plus)
            width += layer.by_width * (g_plus + g_minus) + layer.by_height * box
        c = dr.minimum(c, FULLEST)
        visible = dr.minimum(dr.exp(-t) / (1 - c), 1.0)  # what the others leave of it
        shift, width = shift * visible, width * visible
        terms = (shift * shift, shift * width, width * width, shift * d, width * d, visible * c, c, dr.square(dr.maximum(d, 0.0)))
        return k + 1, *(total + term for total, term in zip(sums, terms, strict=True))

    begin = dr.zeros(mi.UInt32, cut.count), *(dr.zeros(mi.Float, cut.count) for _ in range(8))
    *sums, uncovered = dr.while_loop(begin, lambda k, *_: k < _SAMPLES, body)[1:]
    step = cut.edge_step
    weight = step / (1.0 + uncovered * step / OUTLIER)
    found = [cut.spread(total * factor) for total, factor in zip(sums, [weight] * 5 + [step] * 2, strict=True)]
    across, scale = mi.Vector3f(*(cut.spread(part) for part in cut.across)), cut.spread(cut.scale)
    dr.eval(across, scale, found)  # one by one, each would look at all profiles anew
    return Profiles(cut.shape, across, scale, *found)


def misfit(evidence: Evidence, tubes: Tubes, difference: Float) -> Array:
    """Return the squared difference (V, N), px, integrated over both edges of every node.

    Not a number where a view has none.
    """
    at = evidence.project(tubes.centre_mm)
    cut = Sections.of(evidence, tubes, at)
    whole = np.full(at.shape, np.nan)
    if cut is not None:
        total = dr.zeros(mi.Float, cut.count)
        for k in range(_SAMPLES):
            total += dr.square(cut.read(cut.at_edge(k), difference)[0])
        whole.ravel()[np.array(cut.place)] = np.array(total * cut.edge_step)
    return whole
