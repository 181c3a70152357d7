"""The fast deterministic fidelity: only the primary refracted path of a camera ray, no random numbers.

A ray crosses every interface by its transmitted branch (reflected only in total reflection), weighted by what the
interface lets through, until it meets a light, something opaque, or nothing. Roots that refract have an index close to
the water's, so that light is reflected at grazing angles alone and little turned aside: it comes from the panel as that
which is let through does, and counts as it (docs/decisions/roots-refract.md). The same walk tells whether the ray met
the specimen, and which way it went.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import drjit as dr
import mitsuba as mi

from rhizotwin.sim.lights import Lamps

MAX_DEPTH = 48
"""Surfaces that a ray may meet: what meets more runs on inside a wall by total reflection, and is dark."""
STEP_MM = 0.01
"""How far along itself a ray goes on after an interface: along the ray nothing shifts sideways, and it clears rounding
errors."""
AMBIENT = 0.065
"""Radiance, in units of full scale, that a white thing in the canister shows: what path tracing gives on average."""
LEAST_SPAN_MM = 1.0
"""A shorter stretch of a way through the room of fine things holds none: behind a film on the wall there is 0.05 mm of
water."""


class Room(NamedTuple):
    """An upright cylinder round the canister's axis."""

    radius_mm: float
    low_mm: float
    high_mm: float


class Way(NamedTuple):
    """What rays met."""

    light: mi.Float
    """Radiance that reaches the camera; 1 is full scale."""
    coverage: mi.Float
    """1 where the specimen was met, else 0."""
    course: mi.UInt32
    """Two rays that met the same surfaces one after the other have the same number."""
    end: mi.ShapePtr
    """The last surface met; null where the ray left the scene or met a light."""
    spans: mi.UInt32
    """Number of straight stretches that ran through the given room."""
    start: mi.Point3f
    """Start of the last of these."""
    heading: mi.Vector3f
    """Its direction."""


class Backlit:
    """Follows camera rays through a scene without its lights.

    Parameters
    ----------
    scene : mitsuba.Scene
        Everything but the two lights, in the canister's frame.
    lamps : Lamps
        The lights, placed for the view.
    media : bool
        The scene has attenuating media (turbid water, translucent roots); following them costs time.
    room : Room or None
        Where fine things are; ``spans`` counts the stretches through it.
    roots : str
        Id of the shape whose reflected light counts as let through.
    """

    def __init__(self, scene: Any, lamps: Lamps, *, media: bool, room: Room | None = None, roots: str = "") -> None:
        self.scene = scene
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
        """Choose the shape whose coverage is wanted, by its id; where there is none, nothing is covered."""
        self.target = self.shapes.get(target, dr.zeros(mi.ShapePtr))
        dr.make_opaque(self.target)

    @dr.syntax  # type: ignore[untyped-decorator]
    def follow(self, ray_: Any, active: Any = True) -> Way:
        """Return what rays meet."""
        ray = mi.Ray3f(dr.detach(ray_))  # current segment
        beta = mi.Spectrum(1.0)  # share of the light ahead that reaches the camera
        radiance = mi.Spectrum(0.0)
        coverage = mi.Float(0.0)  # 1: the path met the target
        outside = mi.Bool(True)  # no interface crossed yet: the front light falls straight on what is hit
        medium = dr.zeros(mi.MediumPtr)  # what the segment runs through
        depth = mi.UInt32(0)
        course = mi.UInt32(0)
        end = dr.zeros(mi.ShapePtr)
        spans = mi.UInt32(0)
        start = mi.Point3f(0.0)
        heading = mi.Vector3f(0.0)
        active = mi.Bool(active)

        while dr.hint(active, max_iterations=MAX_DEPTH):
            si = self.scene.ray_intersect(ray, mi.RayFlags.All, coherent=True, active=active)

            if dr.hint(self.room is not None, mode="scalar"):
                within = active & self.crosses_room(ray, si.t)
                start[within] = ray.o
                heading[within] = ray.d
                spans[within] += 1

            # ---- light met: the end of the path; only air is between the canister and a light
            lamp, glow = self.lamps.meet(ray, si.t)
            radiance[active] += beta * glow
            course[active & (lamp > 0)] = course * 31 + lamp
            active &= si.is_valid() & (lamp == 0)

            coverage[active & (si.shape == self.target)] = 1.0
            course[active] = course * 31 + 3 + dr.reinterpret_array(mi.UInt32, si.shape)

            if dr.hint(self.media, mode="scalar"):
                inside = active & (medium != dr.zeros(mi.MediumPtr))
                beta[inside] *= self.let_through(medium, si, inside)

            bs, weight, smooth = self.cross(si, active)

            # ---- something opaque: direct light, unshadowed, or the stray light of the canister's inside
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

    def let_through(self, medium: Any, si: Any, active: Any) -> Any:
        """Return the share of light that a medium lets through on the way to where it ends.

        Parameters
        ----------
        medium : mi.MediumPtr
            What the ray runs through.
        si : mi.SurfaceInteraction3f
            Where the way ends.
        active : mi.Bool
            Rays that count.

        Returns
        -------
        mi.UnpolarizedSpectrum
            Beer and Lambert's exp(-sigma_t t).
        """
        mei = dr.zeros(mi.MediumInteraction3f)
        mei.p, mei.t = si.p, si.t
        _, _, sigma_t = medium.get_scattering_coefficients(mei, active)
        return dr.exp(-sigma_t * (si.t + STEP_MM))

    def cross(self, si: Any, active: Any) -> tuple[Any, Any, Any]:
        """Return the transmitted branch of a surface, its weight, and where the surface is smooth.

        A first sample of almost 1 is above every reflectance but that of total reflection.
        """
        bs, weight = si.bsdf().sample(mi.BSDFContext(), si, 1.0 - 1e-6, mi.Point2f(0.5), active)
        return bs, weight, mi.has_flag(bs.sampled_type, mi.BSDFFlags.Delta) | mi.has_flag(bs.sampled_type, mi.BSDFFlags.Null)

    def shade(self, si: Any, outside: Any, active: Any) -> Any:
        """Return the radiance of a matt surface.

        Parameters
        ----------
        si : mi.SurfaceInteraction3f
            Where the surface is met.
        outside : mi.Bool
            Whether that is in the air, where the lamps shine.
        active : mi.Bool
            Rays that count.

        Returns
        -------
        mi.UnpolarizedSpectrum
            1 is full scale.
        """
        albedo = si.bsdf().eval_diffuse_reflectance(si, active)
        lit = si.wi.z > 0.0
        return dr.select(outside, dr.select(lit, albedo * self.lamps.irradiance(si.p, si.n) / dr.pi, 0.0), albedo * AMBIENT)

    def crosses_room(self, ray: Any, t: Any) -> Any:
        """Tell whether a segment runs through the room for at least `LEAST_SPAN_MM`."""
        low, high, radius = self.bounds
        a = ray.d.x * ray.d.x + ray.d.y * ray.d.y
        b = ray.o.x * ray.d.x + ray.o.y * ray.d.y
        c = ray.o.x * ray.o.x + ray.o.y * ray.o.y - radius * radius
        root = dr.safe_sqrt(b * b - a * c)  # 0 where it passes the cylinder by
        down, up = (low - ray.o.z) / ray.d.z, (high - ray.o.z) / ray.d.z
        near = dr.maximum(dr.maximum((-b - root) / a, dr.minimum(down, up)), 0.0)
        far = dr.minimum(dr.minimum((root - b) / a, dr.maximum(down, up)), t)
        return far - near > LEAST_SPAN_MM
