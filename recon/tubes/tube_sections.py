"""Cross-sections of the tubes at their nodes, in the picture of every view (Dr.Jit)."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from rhizotwin.recon.coverage.evidence import Evidence, Nodes, sine_to_sight
from rhizotwin.recon.device import TO_LAST, Float, UInt32, Vector2f, Vector3f, bilinear, numbers, vectors
from rhizotwin.recon.tubes import translucent_tube
from rhizotwin.recon.tubes.translucent_tube import Layer
from rhizotwin.recon.tubes.tubes import Tubes

SAMPLES = 14
"""Number of samples in a profile. One half of them lies around each of the tube's two edges."""
_MARGIN_PX = 1.8
"""Distance to both sides of each of a tube's edges over which picture and rendering are compared, px. Towards the
inside, the profile ends at the centre line. Elsewhere, the coverage does not depend on shift and width."""
_LEAST_SPEED_PX = 0.3
"""Minimum length in the picture of one millimetre of a tube, px. Tubes viewed along their axis are shorter, and do not
appear as strips."""


@dataclass(frozen=True)
class Sections:
    """Cross-sections of tubes at their nodes, in the pictures. Fields have shape (M,) on the device.

    A view in which a node is not visible, or in which its tube is viewed end-on, has no cross-section of that node.
    """

    shape: tuple[int, int]
    """Number of views V and number of nodes N."""
    place: UInt32
    """Index of each cross-section in a flattened array of shape (V, N) (mi.UInt32)."""
    start: UInt32
    """Offset of the view's picture in flattened pictures (mi.UInt32)."""
    columns: UInt32
    rows: UInt32
    px: Vector2f
    """Pixel coordinates of the node (mi.Vector2f)."""
    normal: Vector2f
    """Unit vector across the tube in the picture (mi.Vector2f)."""
    across: Vector3f
    """Gradient of the node's lateral position in the picture with respect to its position in the canister frame, px/mm
    (mi.Vector3f)."""
    scale: Float
    """Image scale perpendicular to the tube, px/mm (mi.Float)."""
    half_px: Float
    """Half-width of the tube, px (mi.Float)."""
    sine: Float
    """Sine of the angle between the tube and the line of sight (mi.Float)."""
    layers: list[Layer]
    """Strips that represent the tube."""

    @staticmethod
    def cut(evidence: Evidence, tubes: Tubes, at: Nodes) -> Sections | None:
        """Return the cross-sections at the nodes of tubes.

        The result is None if no view shows a node.
        """
        p, count = at.on_device, dr.opaque(mi.UInt32, at.shape[1])
        tangent = vectors(tubes.tangents)
        t = at.in_all_views(tangent)
        place = dr.compress(p.visible & (dr.square(dr.dot(p.du, t)) + dr.square(dr.dot(p.dv, t)) > _LEAST_SPEED_PX**2))
        if not dr.width(place):
            return None
        view = place // count
        node = place - view * count
        px, du, dv = dr.gather(mi.Vector2f, p.px, place), dr.gather(mi.Vector3f, p.du, place), dr.gather(mi.Vector3f, p.dv, place)
        t, radius_mm = dr.gather(mi.Vector3f, tangent, node), dr.gather(mi.Float, numbers(tubes.radius_mm), node)
        normal = dr.normalize(mi.Vector2f(-dr.dot(dv, t), dr.dot(du, t)))
        across = normal.x * du + normal.y * dv
        scale = dr.norm(across)
        half_px, sine = radius_mm * scale, sine_to_sight(du, dv, t)
        layers = translucent_tube.layers(evidence.light, radius_mm, sine, half_px)
        start = view * dr.opaque(mi.UInt32, evidence.pixels)
        return Sections(at.shape, place, start, *evidence.size, px, normal, across, scale, half_px, sine, layers)

    @property
    def count(self) -> int:
        """Return the number of cross-sections."""
        return int(dr.width(self.place))

    def offset(self, k: UInt32, samples: int, reach_px: Float) -> Float:
        """Return the offset of sample k from the tube's centre line, px.

        The samples are evenly spaced from ``-reach_px`` to ``reach_px``.
        """
        return reach_px * ((2.0 * mi.Float(k) - (samples - 1)) / (samples - 1))

    def at_edge(self, k: UInt32 | int) -> Float:
        """Return the offset of sample k from the tube's centre line, px.

        The first half of the `SAMPLES` samples lies around one edge of the tube, the second half around the other.
        Adjacent samples at one edge are `edge_step` apart.
        """
        number, half = mi.Float(k), SAMPLES // 2
        first = number < half
        inward = dr.select(first, number, number - half) + 0.5
        return dr.select(first, -1.0, 1.0) * (self.half_px + _MARGIN_PX - inward * self.edge_step)

    @property
    def edge_step(self) -> Float:
        """Return the spacing of the samples around an edge, px (mi.Float)."""
        return (dr.minimum(self.half_px, _MARGIN_PX) + _MARGIN_PX) * (2.0 / SAMPLES)

    def read(self, offset_px: Float, *pictures: Float) -> list[Float]:
        """Sample flattened pictures of all views with bilinear interpolation.

        The samples are at the distance ``offset_px`` from the tube's centre line.
        """
        u = dr.clip(self.px.x + self.normal.x * offset_px, 0.0, mi.Float(self.columns) - TO_LAST)
        v = dr.clip(self.px.y + self.normal.y * offset_px, 0.0, mi.Float(self.rows) - TO_LAST)
        return [bilinear(picture, self.start, self.columns, u, v) for picture in pictures]

    def spread(self, value: Float) -> Float:
        """Return a flattened array of shape (V, N) with one value for each cross-section (M,) (mi.Float).

        It is 0 where a view has no cross-section of a node.
        """
        whole = dr.zeros(mi.Float, self.shape[0] * self.shape[1])
        dr.scatter(whole, value, self.place)
        return whole
