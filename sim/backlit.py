"""Fast deterministic rendering without random numbers.

For each camera ray, only the primary refracted path is traced. At every interface the ray continues as the transmitted
ray, weighted by the transmittance, or as the reflected ray in the case of total reflection. The path ends at a light or
an opaque surface, or when it leaves the scene. The refractive index of refracting roots is similar to that of water.
Roots therefore reflect light only at grazing angles with a small deflection. The reflected light comes from the panel,
like the transmitted light, and both are added (docs/decisions/roots-refract.md). The same path determines whether the
ray met the specimen, and the sequence of surfaces that it met.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import drjit as dr
import mitsuba as mi

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
        Scene without the two lights, canister frame.
    lamps : Lamps
        Lights at their positions in the view.
    media : bool
        Whether the scene contains attenuating media (turbid water, translucent roots), which increase the time.
    room : Room or None
        Region of fine structures, through which ray segments are counted in ``spans``.
    roots : str
        Identifier of the shape whose reflected light is added to the transmitted light.
    parallel : bool
        Whether the camera's rays are parallel. Embree then intersects rays separately: its search for packets of rays
        (``coherent``), which takes a quarter of the time off, misses surfaces if a component of the direction is zero.
    """

    def __init__(self, scene: Any, lamps: Lamps, *, media: bool, room: Room | None = None, roots: str = "", parallel: bool = False) -> None:
        self.scene = scene
        self.coherent = not parallel
        self.lamps = lamps
        self.media = media
        self.room = room
        self.bounds = [] if room is None else [mi.Float(bound) for bound in (room.low_mm, room.high_mm, room.radius_mm)]
        dr.make_opaque(self.bounds)
        self.shapes = {shape.id(): mi.ShapePtr(shape) for shape in scene.shapes()}
        self.target = dr.zeros(mi.ShapePtr)
        self.roots = self.shapes.get(roots, dr.zeros(mi.ShapePtr))
        dr.make_opaque(self.roots)

    def aim(self, target: str) -> None:
        """Select the shape whose coverage is computed.

        The shape is given by its identifier. If it does not exist, the coverage is zero.
        """
        self.target = self.shapes.get(target, dr.zeros(mi.ShapePtr))
        dr.make_opaque(self.target)

    @dr.syntax  # type: ignore[untyped-decorator]
    def follow(self, ray_: Any, active: Any = True) -> Way:
        """Trace rays through the scene."""
        ray = mi.Ray3f(dr.detach(ray_))  # current segment
        beta = mi.Spectrum(1.0)  # fraction of the light in front of the ray that reaches the camera
        radiance = mi.Spectrum(0.0)
        coverage = mi.Float(0.0)  # 1 after the path met the target
        outside = mi.Bool(True)  # no interface was crossed, so that the front light illuminates surfaces directly
        medium = dr.zeros(mi.MediumPtr)  # medium of the segment
        depth = mi.UInt32(0)
        course = mi.UInt32(0)
        end = dr.zeros(mi.ShapePtr)
        spans = mi.UInt32(0)
        start = mi.Point3f(0.0)
        heading = mi.Vector3f(0.0)
        active = mi.Bool(active)

        while dr.hint(active, max_iterations=MAX_DEPTH):
            si = self.scene.ray_intersect(ray, mi.RayFlags.All, coherent=self.coherent, active=active)

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
            course[active] = course * 31 + 3 + dr.reinterpret_array(mi.UInt32, si.shape)

            if dr.hint(self.media, mode="scalar"):
                inside = active & (medium != dr.zeros(mi.MediumPtr))
                beta[inside] *= self.transmittance(medium, si, inside)

            bs, weight, smooth = self.cross(si, active)

            # ---- opaque surface: direct light without shadows, or stray light inside the canister
            opaque = active & ~smooth
            if opaque:
                end = si.shape
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

        return Way(radiance[0], coverage, course, end, spans, start, heading)

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
