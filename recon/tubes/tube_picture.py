"""Rendering of the coverage of tubes viewed through the water (Dr.Jit).

A segment of a tube appears as a strip in a picture. If its axis has the distance d from a pixel's centre and its
half-width is w, the segment covers the fraction

    c = F(d + w) - F(d - w)

of the pixel, where F(x) is the fraction of the pixel on one side of a straight edge at distance x. For an edge in the
direction (t_x, t_y), F is the integral of a trapezoid. This trapezoid is the square pixel projected along the edge, the
convolution of two boxes of widths a = |t_x| and b = |t_y|. Blur with standard deviation s increases the squared widths
to a^2 + 6 s^2 and b^2 + 6 s^2, which is exact in variance. Roots hide each other: coverages combine as 1 - prod (1 -
c), so that the optical depths t = -log(1 - c) add up. At the joint of two segments, a pixel is assigned to the segment
whose axis is nearer. The last segment of a branch ends in half an ellipse, the picture of a rounded tip, and fades out.
The kernel loops over the rows of each strip and visits only covered pixels, about a third of the bounding box.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import reduce

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon import passes
from rhizotwin.recon.coverage.evidence import Evidence, Nodes, sine_to_sight
from rhizotwin.recon.device import Bool, Float, Int32, Kernel, UInt32, Vector2f, numbers, vectors, wholes
from rhizotwin.recon.optics import projection
from rhizotwin.recon.optics.projection import Projected
from rhizotwin.recon.tubes import translucent_tube
from rhizotwin.recon.tubes.translucent_tube import Layer
from rhizotwin.recon.tubes.tubes import Tubes

PIXEL_SIGMA = 12.0**-0.5
"""Standard deviation of a square pixel, px."""
_NARROWEST_PX = 0.1
"""Minimum width of the two boxes whose convolution is the pixel projected along an edge, px. Without this limit, a box
would have zero width for edges parallel to rows or columns in pictures without blur."""
_WIDE_MM = 0.5
"""Radius of a tube above which its edges are projected, mm. The axis of thinner tubes is in the middle to 0.003 mm."""
_LEAST_PX = 1e-3
"""Minimum length of a segment in a picture, px. The direction of shorter segments is undefined."""
_NOTHING, _ENDS = 1e-4, 4.0
"""Optical depth that is neglected, and the distance beyond a root's tip at which the optical depth has decreased to
this value. The distance is in standard deviations of the blur."""
_STEEPEST = 1e-3
"""Lower limit of the sine of the angle between a segment and the pixel rows or columns. Segments at smaller angles are
clipped with an error of a hundredth of a pixel."""
_FAR_PX = 3.0
"""Distance from an edge beyond which a blurred pixel is taken to lie entirely on one side of the edge, px."""
_HIDDEN = 5.3
"""Optical depth that masked pixels receive. It is equal to that of a tube with full coverage (`FULLEST`)."""
_UNITS = 2.0**20
"""Number of integer units in an optical depth of 1. Unlike that of floating-point numbers, the sum of integers does not
depend on the order in which threads add them, so that a reconstruction can be repeated exactly. In 32 bits, 700 tubes
may cover a pixel."""
FULLEST = 0.995
"""Maximum coverage of a pixel by a tube. It is less than 1, since the optical depth would otherwise be infinite."""


def _on_one_side(x: Float, outer: Float, inner: Float, per_area: Float) -> Float:
    """Return the fraction of a pixel that lies on one side of an edge at distance x.

    The projection of the pixel along the edge is a trapezoid with the half-widths ``outer`` at its base and ``inner``
    at its top, and with the integral 1.
    """
    x = dr.clip(x, -_FAR_PX, _FAR_PX)
    ramps = [dr.square(dr.maximum(x + shift, 0.0)) for shift in (outer, inner, -inner, -outer)]
    return (ramps[0] - ramps[1] - ramps[2] + ramps[3]) * per_area


def project_axes(evidence: Evidence, tubes: Tubes) -> Nodes:
    """Project the nodes of tubes into all views, midway between both edges of the tube.

    Water and lens magnify the two halves of a wide tube differently, so that its axis does not appear in the middle: in
    a canister, by up to 0.1 mm for a root of 10 mm, towards the edge of the canister. The edges are the points beside
    the axis, perpendicular to the line of sight.
    """
    at, wide = evidence.project(tubes.centre_mm), np.flatnonzero(tubes.radius_mm > _WIDE_MM)
    if not len(wide):
        return at
    p, (view, number) = at.on_device, projection.pair_all(at.shape[0], len(wide))
    node = dr.gather(mi.UInt32, wholes(wide), number)
    place = view * dr.opaque(mi.UInt32, at.shape[1]) + node
    visible, px = dr.gather(mi.Bool, p.visible, place), dr.gather(mi.Vector2f, p.px, place)
    du, dv = (dr.gather(mi.Vector3f, part, place) for part in (p.du, p.dv))
    across = dr.cross(dr.gather(mi.Vector3f, vectors(tubes.tangents), node), dr.cross(du, dv))
    aside = dr.gather(mi.Float, numbers(tubes.radius_mm), node) * dr.normalize(across)
    centre = dr.gather(mi.Vector3f, vectors(tubes.centre_mm), node)
    edges = [projection.project(evidence.bank, view, mi.Point3f(centre + side * aside), visible) for side in (-1.0, 1.0)]
    both = edges[0].visible & edges[1].visible
    middle = mi.Vector2f(p.px)
    dr.scatter(middle, dr.select(both, 0.5 * (edges[0].px + edges[1].px), px), place)
    dr.eval(middle)
    return Nodes(at.shape, replace(p, px=middle))


def transmittance(evidence: Evidence, tubes: Tubes, at: Nodes) -> Float:
    """Return the transmittance of tubes and masked pixels in all views (mi.Float, flattened (V, H, W)).

    Parameters
    ----------
    evidence, tubes, at : Evidence, Tubes, Nodes
        Views with their masks, tree of tubes, and positions of its nodes in the pictures.
    """
    passes.add("renderings")
    depth, strips = mi.UInt32((1.0 - mi.Float(evidence.usable)) * (_HIDDEN * _UNITS)), _Strips.project(evidence, tubes, at)
    dr.eval(depth)
    if strips is None:
        return dr.exp(mi.Float(depth) * (-1.0 / _UNITS))
    size, (x, y), (t_x, t_y), blur_px = evidence.size, strips.begin, strips.way, evidence.light.blur_px
    width, height = (mi.Float(edge) for edge in size)
    sigma, spread = (dr.opaque(mi.Float, value) for value in (float(np.hypot(blur_px, PIXEL_SIGMA)), 6.0 * blur_px**2))
    scale = 1.0 / (sigma * 2.0**0.5)
    box_a, box_b = (dr.maximum(dr.sqrt(dr.square(t) + spread), _NARROWEST_PX) for t in (t_x, t_y))
    outer, inner, per_area = 0.5 * (box_a + box_b), 0.5 * dr.abs(box_a - box_b), 0.5 / (box_a * box_b)
    # Covered pixels have |d| < side_px and -end_px < s < length + end_px; an oblique cut reaches farther.
    side_px, is_tip = strips.widest_px + outer, strips.cap_px > 0
    oblique = dr.maximum(*(dr.abs(t.x * t_y - t.y * t_x) / (t.x * t_x + t.y * t_y) for t in strips.cuts))
    end_px = side_px * oblique + dr.select(is_tip, strips.cap_px + _ENDS * sigma, 0.0)
    (begin_x, begin_y), (end_x, end_y) = strips.cuts
    per_cap = dr.select(is_tip, 1.0 / dr.maximum(strips.cap_px, _LEAST_PX), 0.0)
    per_x, per_y = (dr.copysign(1.0 / dr.maximum(dr.abs(t), _STEEPEST), t) for t in (t_x, t_y))
    reach = end_px * dr.abs(t_y) + side_px * dr.abs(t_x)
    first, last = (y + dr.minimum(0.0, strips.length * t_y) - reach, y + dr.maximum(0.0, strips.length * t_y) + reach)
    top, bottom = mi.Int32(dr.clip(dr.ceil(first), 0, height)), mi.Int32(dr.clip(dr.floor(last), -1, height - 1))

    def row_span(v: Int32) -> tuple[Int32, Int32]:
        """Return the first and the last column that the segment covers in row v."""
        e_y = mi.Float(v) - y
        by_side, by_end = side_px * dr.abs(per_y), (0.5 * strips.length + end_px) * dr.abs(per_x)
        middle = e_y * t_x * per_y, (0.5 * strips.length - e_y * t_y) * per_x
        low, high = dr.maximum(middle[0] - by_side, middle[1] - by_end), dr.minimum(middle[0] + by_side, middle[1] + by_end)
        return mi.Int32(dr.clip(dr.ceil(x + low), 0, width)), mi.Int32(dr.clip(dr.floor(x + high), -1, width - 1))

    def body(u: Int32, end: Int32, v: Int32) -> tuple[Int32, Int32, Int32]:
        e_x, e_y = mi.Float(u) - x, mi.Float(v) - y
        s, d = e_x * t_x + e_y * t_y, e_y * t_x - e_x * t_y  # along the segment, across it
        part = dr.clip(s / strips.length, 0, 1)
        cap = dr.sqrt(1 - dr.square(dr.clip((s - strips.length) * per_cap, 0, 1)))
        c = mi.Float(0.0)
        for a, b in zip(*strips.layers, strict=True):
            w = (a.half_px + (b.half_px - a.half_px) * part) * cap
            c += (_on_one_side(d + w, outer, inner, per_area) - _on_one_side(d - w, outer, inner, per_area)) * (
                a.height + (b.height - a.height) * part
            )
        before, beyond = e_x * begin_x + e_y * begin_y, (e_x - strips.length * t_x) * end_x + (e_y - strips.length * t_y) * end_y
        c *= dr.select(is_tip, 0.5 * (1 - dr.erf((beyond - strips.cap_px) * scale)), 1.0)
        value, own = -dr.log(1 - dr.minimum(c, FULLEST)), (before >= 0) & ((beyond < 0) | is_tip)
        place = strips.start + mi.UInt32(v) * size[0] + mi.UInt32(u)
        units, active = mi.UInt32(value * _UNITS + 0.5), own & (value > _NOTHING) & (u <= end)
        dr.scatter_reduce(dr.ReduceOp.Add, depth, units, place, active, mode=dr.ReduceMode.Direct)
        ended, (low, high) = u >= end, row_span(v + 1)
        return dr.select(ended, low, u + 1), dr.select(ended, high, end), dr.select(ended, v + 1, v)

    dr.while_loop((*row_span(top), top), lambda _u, _end, v: v <= bottom, body)
    return dr.exp(mi.Float(depth) * (-1.0 / _UNITS))


@dataclass(frozen=True)
class _Strips:
    """Segments of tubes, projected into all views that show both of their ends.

    All fields have shape (M,) on the device.
    """

    start: UInt32
    """Offset of the view's picture in flattened pictures (mi.UInt32)."""
    begin: Vector2f
    """Pixel coordinates of the segment's first end (mi.Vector2f)."""
    way: Vector2f
    """Unit vector from the segment's first to its second end (mi.Vector2f)."""
    length: Float
    """Length of the segment, px (mi.Float)."""
    cuts: tuple[Vector2f, Vector2f]
    """Unit normals of the two lines that clip the segment, one at each end (mi.Vector2f).

    Adjacent segments share the line that bisects the angle between them. If this angle is sharper than a right angle,
    each segment is clipped by its own line. With lines perpendicular to the segments, bends had notches on their
    outside, and fits moved the nodes of wide tubes back and forth."""
    half_px: tuple[Float, Float]
    """Half-widths at both ends of the segment, px (mi.Float)."""
    cap_px: Float
    """Length of the rounded tip after the segment, px (mi.Float). It is 0 where the branch continues."""
    layers: tuple[list[Layer], list[Layer]]
    """Strips that represent the segment at both ends."""

    @property
    def widest_px(self) -> Float:
        """Return the largest half-width of the strips, px (mi.Float).

        It exceeds that of the root if the root has hairs.
        """
        return reduce(dr.maximum, [layer.half_px for end in self.layers for layer in end])

    @staticmethod
    def project(evidence: Evidence, tubes: Tubes, at: Nodes) -> _Strips | None:
        """Project the segments of tubes into all views.

        The result is None if no view shows a segment.
        """
        p, (views, nodes), segments = at.on_device, at.shape, tubes.segments
        count, nodes = dr.opaque(mi.UInt32, len(segments)), dr.opaque(mi.UInt32, nodes)
        numbered = [wholes(end) for end in segments.T]

        def ends(place: UInt32) -> tuple[UInt32, UInt32, list[UInt32]]:
            """Return the index of the view, the index of the segment, and the indices of the nodes at its two ends.

            The indices of the nodes refer to flattened arrays of shape (V, N).
            """
            view = place // count
            segment = place - view * count
            return view, segment, [view * nodes + dr.gather(mi.UInt32, end, segment) for end in numbered]

        _, _, both = ends(dr.arange(mi.UInt32, views * len(segments)))
        visible = [dr.gather(mi.Bool, p.visible, end) for end in both]
        here, there = (dr.gather(mi.Vector2f, p.px, end) for end in both)
        drawn = dr.compress(visible[0] & visible[1] & (dr.norm(there - here) > _LEAST_PX))
        if not dr.width(drawn):
            return None
        view, segment, both = ends(drawn)
        here, there = (dr.gather(mi.Vector2f, p.px, end) for end in both)
        length = dr.norm(there - here)
        way = (there - here) / length
        beside = [view * nodes + dr.gather(mi.UInt32, wholes(node), segment) for node in tubes.segment_neighbours.T]
        cuts = _cuts(p, beside, here, there, way)
        along = vectors(tubes.centre_mm[segments[:, 1]] - tubes.centre_mm[segments[:, 0]])
        along = dr.normalize(dr.gather(mi.Vector3f, along, segment))
        layers, half_px = [], []
        for end, radii in zip(both, tubes.segment_radii, strict=True):
            du, dv = (dr.gather(mi.Vector3f, part, end) for part in (p.du, p.dv))
            radius_mm = dr.gather(mi.Float, numbers(radii), segment)
            half_px.append(radius_mm * dr.norm(way.x * dv - way.y * du))  # across the segment
            sine = sine_to_sight(du, dv, along)
            layers.append(translucent_tube.layers(evidence.light, radius_mm, sine, half_px[-1]))
        start = view * dr.opaque(mi.UInt32, evidence.pixels)
        # the water magnifies sideways: the picture of a sphere is an ellipse
        is_tip = dr.gather(mi.Float, numbers(tubes.segment_neighbours[:, 1] == segments[:, 1]), segment)
        cap_px = is_tip * radius_mm * dr.norm(way.x * du + way.y * dv)
        return _Strips(start, here, way, length, cuts, (half_px[0], half_px[1]), cap_px, (layers[0], layers[1]))


def _cuts(p: Projected, beside: list[UInt32], here: Vector2f, there: Vector2f, way: Vector2f) -> tuple[Vector2f, Vector2f]:
    """Return the unit normals of the lines that clip segments at both ends.

    Parameters
    ----------
    beside : list of UInt32
        Indices of the nodes before and after each segment.
    here, there, way : Vector2f
        Pixels of both ends, and unit vector from the first to the second.
    """
    before, after = (dr.gather(mi.Vector2f, p.px, node) for node in beside)
    onto, onward = here - before, after - there
    joined = [dr.gather(mi.Bool, p.visible, node) & (dr.dot(w, way) > _LEAST_PX) for node, w in zip(beside, (onto, onward), strict=True)]
    onto, onward = (w / dr.maximum(dr.norm(w), _LEAST_PX) for w in (onto, onward))

    def cut(mine: Vector2f, is_joined: Bool, other: Vector2f, has_other: Bool) -> Vector2f:
        # A free end is clipped parallel to the other cut: a perpendicular cut would turn with its node and push it
        # aside.
        free = dr.select(has_other & (dr.dot(other, way) > 0.5**0.5), other, way)
        return dr.select(is_joined, dr.normalize(mine + way), free)

    return cut(onto, joined[0], onward, joined[1]), cut(onward, joined[1], onto, joined[0])


@dataclass(frozen=True)
class Rendering:
    """Tubes rendered in all views, with the residual coverage."""

    evidence: Evidence
    tubes: Tubes
    at: Nodes
    """Positions of the nodes in the pictures."""
    passing: Float
    """Transmittance of the tubes in all views (mi.Float, flattened (V, H, W)). Unlike its logarithm, it may be averaged
    over pixels."""
    difference: Kernel
    """Measured coverage minus coverage by the tubes, in all views (mi.Float16, flattened (V, H, W)). It is 0 for masked
    pixels."""

    @staticmethod
    def draw(evidence: Evidence, tubes: Tubes) -> Rendering:
        """Render tubes in all views."""
        at = project_axes(evidence, tubes)
        passing = transmittance(evidence, tubes, at)
        difference = mi.Float16((evidence.opacity - (1 - passing)) * evidence.usable)
        dr.eval(passing, difference)
        return Rendering(evidence, tubes, at, passing, difference)

    @property
    def coverage(self) -> NDArray[np.float32]:
        """Return the coverage (V, H, W) by tubes. Masked pixels are covered."""
        width, height = self.evidence.image_wh
        return 1.0 - np.array(self.passing, np.float32).reshape(-1, height, width)

    @property
    def misfit(self) -> float:
        """Return the sum of the squared residual coverage over all pixels."""
        return float(dr.sum(dr.square(mi.Float64(self.difference)))[0])

    def change(self, evidence: Evidence, tubes: Tubes, step: float) -> Kernel:
        """Return the derivative of the coverage in all views with respect to a light parameter or the radii.

        It is the difference to a second rendering, divided by ``step``. The result is mi.Float16, flattened (V, H, W).

        Parameters
        ----------
        evidence, tubes : Evidence, Tubes
            Evidence and tubes with one parameter increased by ``step``, and the nodes at the same positions.
        """
        change = (self.passing - transmittance(evidence, tubes, self.at)) * mi.Float(self.evidence.usable)
        change = mi.Float16(change * dr.opaque(mi.Float, 1.0 / step))
        dr.eval(change)
        return change
