"""Closed-form paths through the clear wall of a round canister.

Most rays of a picture cross the wall, the water and the wall again, and meet nothing else but the specimen. For these
rays, the intersections with the two cylinders, Snell's law and Fresnel's equations are evaluated directly, and Mitsuba
only searches the straight segment in the water. All other rays are traced by Mitsuba (`sim.backlit`).
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np

from rhizotwin.scenes.model import Scene
from rhizotwin.sim.world import World

OUTER_WALL, INNER_WALL = "outer_wall", "inner_wall"
"""Names of the surfaces of the wall in the Mitsuba scene."""
ASIDE = {"water_surface", "floor", "base_side", "base_bottom", "rim", "grid", "dry_wall", "strip", "pot_top"}
"""Names of shapes above, below and around the clear wall, which rays through it do not meet."""
MARGIN_MM = 0.1
"""Distance from these shapes within which rays are traced by Mitsuba, mm. It is larger than rounding errors."""


class Segment(NamedTuple):
    """Straight segments of rays in one medium."""

    clear: mi.Bool
    """Whether the ray has met the clear wall only."""
    o: mi.Point3f
    """Start of the segment, mm."""
    d: mi.Vector3f
    """Unit direction of the segment."""
    beta: mi.Float
    """Ratio of the radiance that reaches the camera to the radiance in the segment."""


class ClearWall:
    """Part of a round wall between the floor and the net pot that is in contact with the water.

    Parameters
    ----------
    scene, world : Scene, World
        Nominal rig, and its drawn disturbances.
    """

    def __init__(self, scene: Scene, world: World) -> None:
        can, pot, seat = world.canister, scene.net_pot, world.canister_from_strip
        tilt = float(np.hypot(seat[2, 0], seat[2, 1]))
        skirt_mm = float(seat[2, 2] * pot.skirt_bottom_mm + seat[2, 3]) - tilt * pot.outer_radius_mm
        aside_mm = float(np.hypot(seat[0, 3], seat[1, 3])) + tilt * abs(pot.skirt_bottom_mm)
        self.low_mm = mi.Float(can.floor_z_mm + MARGIN_MM)
        self.high_mm = mi.Float(min(skirt_mm, scene.water.level_mm, pot.grid_z_mm, 0.0) - MARGIN_MM)
        self.around_mm = mi.Float(max(pot.outer_radius_mm + aside_mm, can.outer_radius_mm) + MARGIN_MM)
        self.radii_mm = [mi.Float(can.outer_radius_mm), mi.Float(can.inner_radius_mm)]
        self.n = [mi.Float(n) for n in (scene.surroundings.n, can.n_wall, world.n_water)]
        dr.make_opaque(self.low_mm, self.high_mm, self.around_mm, self.radii_mm, self.n)

    @staticmethod
    def of(scene: Scene, world: World, shapes: Iterable[Any], *, reach_mm: float) -> ClearWall | None:
        """Return the clear wall of a rig.

        Parameters
        ----------
        scene, world : Scene, World
            Nominal rig, and its drawn disturbances.
        shapes : iterable of mitsuba.Shape
            All shapes of the rig without the specimen.
        reach_mm : float
            Largest distance of roots and leaves from the canister's axis, mm.

        Returns
        -------
        ClearWall or None
            Clear wall. None if the wall is not round, other shapes are near it, or leaves are outside the canister.
        """
        types = {shape.id(): shape.shape_type() for shape in shapes}
        walls = {types.get(name) for name in (OUTER_WALL, INNER_WALL)}
        is_clear = walls == {mi.ShapeType.Cylinder.value} and not types.keys() - ASIDE - {OUTER_WALL, INNER_WALL}
        return ClearWall(scene, world) if is_clear and reach_mm < world.canister.inner_radius_mm else None

    def faces(self, ray: Any) -> Any:
        """Return whether a camera ray comes to the wall, and not to the net pot or the base."""
        at, half2 = _meet(ray.o, ray.d, self.around_mm, -1.0)
        return (half2 > 0.0) & self._is_within(at)

    def enter(self, ray: Any) -> tuple[Segment, Any]:
        """Return the segments in the water of rays that face the wall, and the distances to the wall, mm."""
        outside = Segment(mi.Bool(True), ray.o, ray.d, mi.Float(1.0))
        in_wall = self._cross(outside, self.radii_mm[0], -1.0, self.n[0], self.n[1])
        return self._cross(in_wall, self.radii_mm[1], -1.0, self.n[1], self.n[2]), dr.norm(in_wall.o - ray.o)

    def leave(self, water: Segment) -> tuple[Segment, Any]:
        """Return the segments behind the canister, and the lengths of the segments in the water, mm."""
        in_wall = self._cross(water, self.radii_mm[1], 1.0, self.n[2], self.n[1])
        behind = self._cross(in_wall, self.radii_mm[0], 1.0, self.n[1], self.n[0])
        at, _ = _meet(behind.o, behind.d, self.around_mm, 1.0)
        return behind._replace(clear=behind.clear & self._is_within(at)), dr.norm(in_wall.o - water.o)

    def _is_within(self, p: Any) -> Any:
        return (p.z > self.low_mm) & (p.z < self.high_mm)

    def _cross(self, segment: Segment, radius_mm: Any, side: float, n_from: Any, n_to: Any) -> Segment:
        """Return the segments behind an interface: the nearest (-1) or farthest (1) point of a cylinder on each ray."""
        p, half2 = _meet(segment.o, segment.d, radius_mm, side)
        normal = mi.Vector3f(p.x, p.y, 0.0) * (side / radius_mm)  # in the direction of the ray
        cos_i = dr.dot(segment.d, normal)
        reflectance, cos_t, _, ratio = mi.fresnel(cos_i, n_to / n_from)
        d = dr.normalize(segment.d * ratio + normal * (dr.abs(cos_t) - ratio * cos_i))  # Snell's law
        clear = segment.clear & (half2 > 0.0) & (reflectance < 1.0) & self._is_within(p)
        return Segment(clear, p, d, segment.beta * (1.0 - reflectance) * ratio * ratio)


def _meet(o: Any, d: Any, radius_mm: Any, side: float) -> tuple[Any, Any]:
    """Return the point of a cylinder about the z axis on each ray, and half the chord's length squared, mm^2.

    The chord's middle is computed first, since cancellation is small there.
    """
    a = d.x * d.x + d.y * d.y
    middle = o - d * ((o.x * d.x + o.y * d.y) / a)
    half2 = (radius_mm * radius_mm - middle.x * middle.x - middle.y * middle.y) / a
    return middle + d * (side * dr.safe_sqrt(half2)), half2
