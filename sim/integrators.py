"""The fast deterministic fidelity: only the primary refracted path of a camera ray, no random numbers.

A ray crosses every interface by its transmitted branch (reflected only in total reflection), weighted by what the interface lets
through, until it meets a light, something opaque, or nothing. The same walk tells whether the ray met the specimen.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import drjit as dr
import mitsuba as mi

PLUGIN = "backlit"
MAX_DEPTH = 48
STEP_MM = 0.01
"""How far along itself a ray goes on after an interface: along the ray nothing shifts sideways, and it clears rounding errors."""
AMBIENT = 0.065
"""Radiance, in units of full scale, that a white thing in the canister shows: what path tracing gives on average."""
LIGHT_SAMPLES = 4


def register() -> None:
    """Make the integrator known to Mitsuba's current variant (again and again does no harm)."""
    _register_for(mi.variant())


def integrator_dict(*, media: bool, specimen: str = "specimen") -> dict[str, Any]:
    """Return the Mitsuba description of the backlit integrator.

    Parameters
    ----------
    media : bool
        The scene has attenuating media (turbid water, translucent roots); following them costs time.
    specimen : str
        Id of the shape whose coverage is the integrator's second output.
    """
    register()
    return {"type": PLUGIN, "media": media, "specimen": specimen}


@cache
def _register_for(variant: str) -> None:
    class BacklitIntegrator(mi.SamplingIntegrator):
        """Primary refracted path with Fresnel transmittances; the extra channel is the specimen's coverage."""

        def __init__(self, props: mi.Properties) -> None:
            super().__init__(props)
            self.media = bool(props["media"])
            self.specimen = str(props["specimen"])

        def aov_names(self) -> list[str]:
            return ["coverage"]

        @dr.syntax  # type: ignore[untyped-decorator]
        def sample(self, scene: Any, sampler: Any, ray_: Any, medium_: Any = None, active: Any = True) -> Any:
            del sampler, medium_
            specimen = dr.zeros(mi.ShapePtr)
            for shape in scene.shapes():
                if shape.id() == self.specimen:
                    specimen = mi.ShapePtr(shape)
            context = mi.BSDFContext()

            ray = mi.Ray3f(dr.detach(ray_))  # current segment
            beta = mi.Spectrum(1.0)  # share of the light ahead that reaches the camera
            radiance = mi.Spectrum(0.0)
            coverage = mi.Float(0.0)  # 1: the path met the specimen
            outside = mi.Bool(True)  # no interface crossed yet: the front light falls straight on what is hit
            medium = dr.zeros(mi.MediumPtr)  # what the segment runs through
            depth = mi.UInt32(0)
            active = mi.Bool(active)

            while dr.hint(active, max_iterations=MAX_DEPTH):
                si = scene.ray_intersect(ray, mi.RayFlags.All, coherent=True, active=active)
                active &= si.is_valid()
                coverage[active & (si.shape == specimen)] = 1.0

                if dr.hint(self.media, mode="scalar"):
                    inside = active & (medium != dr.zeros(mi.MediumPtr))
                    mei = dr.zeros(mi.MediumInteraction3f)
                    mei.p, mei.t = si.p, si.t
                    _, _, sigma_t = medium.get_scattering_coefficients(mei, inside)
                    beta[inside] *= dr.exp(-sigma_t * (si.t + STEP_MM))

                # ---- light met: the end of the path
                radiance[active] += beta * si.emitter(scene).eval(si, active)

                # ---- the transmitted branch: a first sample of almost 1 is above every reflectance but that of total reflection
                bs, weight = si.bsdf().sample(context, si, 1.0 - 1e-6, mi.Point2f(0.5), active)
                smooth = mi.has_flag(bs.sampled_type, mi.BSDFFlags.Delta) | mi.has_flag(bs.sampled_type, mi.BSDFFlags.Null)

                # ---- something opaque: direct light, unshadowed, or the stray light of the canister's inside
                opaque = active & ~smooth
                if opaque:
                    radiance += dr.select(opaque, beta * self.shade(scene, si, outside, opaque), 0.0)

                active &= smooth
                beta[active] *= weight * bs.pdf
                outside &= ~mi.has_flag(bs.sampled_type, mi.BSDFFlags.DeltaTransmission)
                wo = si.to_world(bs.wo)
                if dr.hint(self.media, mode="scalar"):
                    crossed = active & si.is_medium_transition()
                    medium[crossed] = si.target_medium(wo)
                ray.o = si.p + wo * STEP_MM
                ray.d = wo
                depth += 1
                active &= (depth < MAX_DEPTH) & (dr.max(beta) > 1e-6)

            return radiance, mi.Bool(True), [coverage]

        def shade(self, scene: Any, si: Any, outside: Any, active: Any) -> Any:
            albedo = si.bsdf().eval_diffuse_reflectance(si, active)
            irradiance = mi.Spectrum(0.0)
            for number in range(LIGHT_SAMPLES):
                point = mi.Point2f((number + 0.5) / LIGHT_SAMPLES, (0.5 + number * 0.618) % 1.0)
                towards, light = scene.sample_emitter_direction(si, point, False, active & outside)
                irradiance += light * dr.maximum(dr.dot(si.n, towards.d), 0.0) / LIGHT_SAMPLES
            lit = si.wi.z > 0.0
            return dr.select(outside, dr.select(lit, albedo * irradiance / dr.pi, 0.0), albedo * AMBIENT)

    del variant
    mi.register_integrator(PLUGIN, BacklitIntegrator)
