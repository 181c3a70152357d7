"""Fast deterministic rendering without random numbers.

For each camera ray, only the primary refracted path is traced. At every interface the ray continues as the transmitted
ray, weighted by the transmittance, or as the reflected ray in the case of total reflection. The path ends at a light or
an opaque surface, or when it leaves the scene. The refractive index of refracting roots is similar to that of water.
Roots therefore reflect light only at grazing angles with a small deflection. The reflected light comes from the panel,
like the transmitted light, and both are added (docs/decisions/roots-refract.md). The same path determines whether the
ray met the specimen, and the sequence of surfaces that it met.

Rays through the clear wall of a round canister, which are most rays, are computed in closed form up to the specimen and
behind it (`sim.clear_wall`). Mitsuba traces all others.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import drjit as dr
import mitsuba as mi

from rhizotwin.sim.clear_wall import INNER_WALL, OUTER_WALL, ClearWall
from rhizotwin.sim.lights import Lamps

MAX_DEPTH = 48
"""Maximum number of surfaces on a path. A ray with a longer path is trapped in a wall by total reflection, and its
pixel is dark."""
STEP_MM = 0.01
"""Distance by which the origin of a ray is moved beyond an interface, mm. It is larger than rounding errors. Since it
is along the ray, it does not displace the ray sideways."""
AMBIENT = 0.065
"""Radiance of a white diffuse object inside the canister that is illuminated by stray light, as a fraction of full
scale. It is an average obtained by path tracing."""
LEAST_SPAN_MM = 1.0
"""Minimum length of a ray segment within the region of fine structures, mm. Shorter segments are not counted, because
they contain none of these structures. An example is the 0.05 mm of water behind a film on the wall."""


class Room(NamedTuple):
    """Vertical cylinder about the canister's axis."""

    radius_mm: float
    """Radius of the cylinder, mm."""
    low_mm: float
    """Height of the lower end, mm, canister frame."""
    high_mm: float
    """Height of the upper end, mm, canister frame."""


class Way(NamedTuple):
    """Results of tracing rays through the scene."""

    light: mi.Float
    """Radiance that reaches the camera, as a fraction of full scale."""
    coverage: mi.Float
    """1 if a ray met the specimen, otherwise 0."""
    course: mi.UInt32
    """Identifier of the sequence of surfaces that a ray met. It is equal for rays that met the same surfaces in the
    same order."""
    end: mi.ShapePtr
    """Last surface that a ray met. It is null if the ray left the scene or met a light."""
    facing: mi.Float
    """Cosine of the angle between a ray and the normal of the last surface."""
    spans: mi.UInt32
    """Number of straight ray segments through the region of fine structures."""
    start: mi.Point3f
    """Start of the last ray segment through the region of fine structures, mm."""
    heading: mi.Vector3f
    """Unit direction of the last ray segment through the region of fine structures."""


class Backlit:
    """Tracer of primary camera rays through a Mitsuba scene.

    Parameters
    ----------
    scene : mitsuba.Scene
        Rig without the two lights and without the specimen, canister frame.
    specimen : mitsuba.Scene or None
        Specimen with root hairs and shoot. It is searched only up to the nearest surface of the rig, which Embree does
        not do within one scene, because it searches triangles before other surfaces.
    lamps : Lamps
        Lights at their positions in the view.
    media : bool
        Whether the scene contains attenuating media (turbid water, translucent roots), which increase the time.
    room : Room or None
        Region of fine structures, through which ray segments are counted in ``spans``.
    wall : ClearWall or None
        Clear wall of the rig, through which rays are computed in closed form if nothing else attenuates them.
    roots : str
        Identifier of the shape whose reflected light is added to the transmitted light.
    parallel : bool
        Whether the camera's rays are parallel. Embree then intersects rays separately: its search for packets of rays
        (``coherent``), which takes a quarter of the time off, misses surfaces if a component of the direction is zero.
    """

    def __init__(
        self,
        scene: Any,
        specimen: Any,
        lamps: Lamps,
        *,
        media: bool,
        room: Room | None = None,
        wall: ClearWall | None = None,
        roots: str = "",
        parallel: bool = False,
    ) -> None:
        self.scene = scene
        self.specimen = specimen
        self.coherent = not parallel
        self.lamps = lamps
        self.media = media
        self.room = room
        self.bounds = [] if room is None else [mi.Float(bound) for bound in (room.low_mm, room.high_mm, room.radius_mm)]
        dr.make_opaque(self.bounds)
        self.wall = None if media else wall
        parts = [scene] if specimen is None else [scene, specimen]
        self.shapes = {shape.id(): mi.ShapePtr(shape) for part in parts for shape in part.shapes()}
        self.target = dr.zeros(mi.ShapePtr)
        self.roots = self.shapes.get(roots, dr.zeros(mi.ShapePtr))
        dr.make_opaque(self.roots)

    def aim(self, target: str) -> None:
        """Select the shape whose coverage is computed.

        The shape is given by its identifier. If it does not exist, the coverage is zero.
        """
        self.target = self.shapes.get(target, dr.zeros(mi.ShapePtr))
        dr.make_opaque(self.target)

    def follow(self, ray: Any, active: Any = True) -> Way:
        """Trace rays through the scene."""
        ray, active = mi.Ray3f(dr.detach(ray)), mi.Bool(active)
        if self.wall is None:
            return self._trace(ray, active)
        way, done = self._pass_wall(ray, active, self.wall)
        return Way(*(dr.select(done, *values) for values in zip(way, self._trace(ray, active & ~done), strict=True)))

    @dr.syntax  # type: ignore[untyped-decorator]
    def _pass_wall(self, ray: Any, active: Any, wall: ClearWall) -> tuple[Way, Any]:
        """Compute rays through the clear wall, and return whether a ray is one of them."""
        light = mi.Float(0.0)
        coverage = mi.Float(0.0)
        course = mi.UInt32(0)
        end = dr.zeros(mi.ShapePtr)
        facing = mi.Float(0.0)
        spans = mi.UInt32(0)
        start = mi.Point3f(0.0)
        heading = mi.Vector3f(0.0)
        done = active & wall.faces(ray)
        if done:
            water, ahead_mm = wall.enter(ray)
            behind, span_mm = wall.leave(water)
            lamp, _ = self.lamps.meet(ray, ahead_mm)
            done &= water.clear & (lamp == 0)
            swim = mi.Ray3f(water.o, water.d)
            swim.maxt = span_mm
            course = self._extend(self._extend(course, self.shapes[OUTER_WALL]), self.shapes[INNER_WALL])

            # ---- opaque specimen
            met = self._meet_specimen(swim, done)
            hit = done & met.is_valid()
            si = met.compute_surface_interaction(swim, mi.RayFlags.All, hit)
            end = dr.select(hit, met.shape, end)
            facing = dr.abs(si.wi.z)
            of_wall = (self.target == self.shapes[OUTER_WALL]) | (self.target == self.shapes[INNER_WALL])
            coverage = dr.select(of_wall | (hit & (met.shape == self.target)), 1.0, 0.0)

            # ---- no specimen: light behind the canister
            lamp, glow = self.lamps.meet(mi.Ray3f(behind.o, behind.d), dr.largest(mi.Float))
            through = self._extend(self._extend(course, self.shapes[INNER_WALL]), self.shapes[OUTER_WALL])
            through = dr.select(lamp > 0, through * 31 + lamp, through)
            course = dr.select(hit, self._extend(course, met.shape), through)
            light = dr.select(hit, water.beta * self.shade(si, mi.Bool(False), hit)[0], behind.beta * glow[0])
            done &= hit | behind.clear

            if dr.hint(self.room is not None, mode="scalar"):
                within = self.crosses_room(swim, dr.minimum(met.t, span_mm))
                spans = dr.select(within, mi.UInt32(1), spans)
                start = swim.o
                heading = swim.d
        return Way(light, coverage, course, end, facing, spans, start, heading), done

    def _meet(self, ray: Any, active: Any) -> Any:
        """Return the first intersection with rig and specimen."""
        of_rig = self.scene.ray_intersect_preliminary(ray, False, active=active)
        bounded = mi.Ray3f(ray)
        bounded.maxt = of_rig.t
        of_specimen = self._meet_specimen(bounded, active)
        return dr.select(of_specimen.is_valid(), of_specimen, of_rig)

    def _meet_specimen(self, ray: Any, active: Any) -> Any:
        """Return the first intersection with the specimen."""
        if self.specimen is None:
            return dr.zeros(mi.PreliminaryIntersection3f)
        return self.specimen.ray_intersect_preliminary(ray, self.coherent, active=active)

    def _extend(self, course: Any, shape: Any) -> Any:
        """Return the identifier of a sequence of surfaces to which a surface is added."""
        return course * 31 + 3 + dr.reinterpret_array(mi.UInt32, shape)

    @dr.syntax  # type: ignore[untyped-decorator]
    def _trace(self, ray_: Any, active: Any) -> Way:
        """Trace rays with Mitsuba."""
        ray = mi.Ray3f(ray_)  # current segment
        beta = mi.Spectrum(1.0)  # fraction of the light in front of the ray that reaches the camera
        radiance = mi.Spectrum(0.0)
        coverage = mi.Float(0.0)  # 1 after the path met the target
        outside = mi.Bool(True)  # no interface was crossed, so that the front light illuminates surfaces directly
        medium = dr.zeros(mi.MediumPtr)  # medium of the segment
        depth = mi.UInt32(0)
        course = mi.UInt32(0)
        end = dr.zeros(mi.ShapePtr)
        facing = mi.Float(0.0)
        spans = mi.UInt32(0)
        start = mi.Point3f(0.0)
        heading = mi.Vector3f(0.0)

        while dr.hint(active, max_iterations=MAX_DEPTH):
            si = self._meet(ray, active).compute_surface_interaction(ray, mi.RayFlags.All, active)

            if dr.hint(self.room is not None, mode="scalar"):
                within = active & self.crosses_room(ray, si.t)
                start[within] = ray.o
                heading[within] = ray.d
                spans[within] += 1

            # ---- light met: end of the path; between canister and lights there is only air
            lamp, glow = self.lamps.meet(ray, si.t)
            radiance[active] += beta * glow
            course[active & (lamp > 0)] = course * 31 + lamp
            active &= si.is_valid() & (lamp == 0)

            coverage[active & (si.shape == self.target)] = 1.0
            course[active] = self._extend(course, si.shape)

            if dr.hint(self.media, mode="scalar"):
                inside = active & (medium != dr.zeros(mi.MediumPtr))
                beta[inside] *= self.transmittance(medium, si, inside)

            bs, weight, smooth = self.cross(si, active)

            # ---- opaque surface: direct light without shadows, or stray light inside the canister
            opaque = active & ~smooth
            if opaque:
                end = si.shape
                facing = dr.abs(si.wi.z)
                radiance += dr.select(opaque, beta * self.shade(si, outside, opaque), 0.0)

            active &= smooth
            beta[active] *= weight * dr.select(si.shape == self.roots, 1.0, bs.pdf)
            outside &= ~mi.has_flag(bs.sampled_type, mi.BSDFFlags.DeltaTransmission)
            wo = si.to_world(bs.wo)
            if dr.hint(self.media, mode="scalar"):
                crossed = active & si.is_medium_transition()
                medium[crossed] = si.target_medium(wo)
            ray.o = si.p + wo * STEP_MM
            ray.d = wo
            depth += 1
            active &= (depth < MAX_DEPTH) & (dr.max(beta) > 1e-6)

        return Way(radiance[0], coverage, course, end, facing, spans, start, heading)

    def transmittance(self, medium: Any, si: Any, active: Any) -> Any:
        """Return the transmittance of a medium along a ray segment.

        Parameters
        ----------
        medium : mi.MediumPtr
            Medium of the segment.
        si : mi.SurfaceInteraction3f
            Intersection with the surface at the end of the segment.
        active : mi.Bool
            Active rays.

        Returns
        -------
        mi.UnpolarizedSpectrum
            Transmittance exp(-sigma_t t) (Beer-Lambert law).
        """
        mei = dr.zeros(mi.MediumInteraction3f)
        mei.p, mei.t = si.p, si.t
        _, _, sigma_t = medium.get_scattering_coefficients(mei, active)
        return dr.exp(-sigma_t * (si.t + STEP_MM))

    def cross(self, si: Any, active: Any) -> tuple[Any, Any, Any]:
        """Return the transmitted direction at a surface, its weight, and whether the surface is smooth.

        The scattering function is sampled with a first random number close to 1. It exceeds every reflectance below 1,
        so that the ray is reflected only in the case of total reflection.
        """
        bs, weight = si.bsdf().sample(mi.BSDFContext(), si, 1.0 - 1e-6, mi.Point2f(0.5), active)
        return bs, weight, mi.has_flag(bs.sampled_type, mi.BSDFFlags.Delta) | mi.has_flag(bs.sampled_type, mi.BSDFFlags.Null)

    def shade(self, si: Any, outside: Any, active: Any) -> Any:
        """Return the radiance of a diffuse surface.

        Side lights are distant and illuminate without shadows, from both sides.

        Parameters
        ----------
        si : mi.SurfaceInteraction3f
            Intersection with the surface.
        outside : mi.Bool
            Whether the surface is in air, where the lamps illuminate it.
        active : mi.Bool
            Active rays.

        Returns
        -------
        mi.UnpolarizedSpectrum
            Radiance, as a fraction of full scale.
        """
        albedo = si.bsdf().eval_diffuse_reflectance(si, active)
        lit = si.wi.z > 0.0
        inside = AMBIENT
        if dr.hint(self.lamps.side_level > 0.0, mode="scalar"):
            inside = AMBIENT + self.lamps.side_level * dr.abs(dr.dot(si.n, self.lamps.side))
        return dr.select(outside, dr.select(lit, albedo * self.lamps.irradiance(si.p, si.n) / dr.pi, 0.0), albedo * inside)

    def crosses_room(self, ray: Any, t: Any) -> Any:
        """Return whether the length of a ray segment in the region of fine structures exceeds `LEAST_SPAN_MM`."""
        low, high, radius = self.bounds
        a = ray.d.x * ray.d.x + ray.d.y * ray.d.y
        b = ray.o.x * ray.d.x + ray.o.y * ray.d.y
        c = ray.o.x * ray.o.x + ray.o.y * ray.o.y - radius * radius
        root = dr.safe_sqrt(b * b - a * c)  # 0 if the ray misses the cylinder
        down, up = (low - ray.o.z) / ray.d.z, (high - ray.o.z) / ray.d.z
        near = dr.maximum(dr.maximum((-b - root) / a, dr.minimum(down, up)), 0.0)
        far = dr.minimum(dr.minimum((root - b) / a, dr.maximum(down, up)), t)
        return far - near > LEAST_SPAN_MM
