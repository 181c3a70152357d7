"""Tubes of translucent roots: the strips that stand for them, their pictures, and the attenuation that pictures tell."""

from dataclasses import replace
from functools import cache

import mitsuba as mi
import numpy as np
import pytest
from scipy.integrate import quad

from rhizotwin.recon.coverage.evidence import Evidence
from rhizotwin.recon.tubes import translucent_tube, tube_picture, tube_profiles, tubes
from rhizotwin.recon.tubes.tube_picture import Rendering
from rhizotwin.scenes.model import Camera, CapturePlan, Ring, Scene
from tests.recon.strings import blank_of, drawn

RINGS = Ring(views=8), Ring(views=8, height_mm=60.0, tilt_deg=15.0)


@cache
def dark() -> Evidence:
    """Return pictures without roots, from two heights."""
    return blank_of(Scene(camera=Camera().resized((400, 300)), plan=CapturePlan(rings=RINGS)))


def straight(*ends: tuple[tuple[float, float, float], tuple[float, float, float], float]) -> tubes.Tubes:
    """Return straight tubes from one point to another, each with a radius."""
    return tubes.place_nodes([np.linspace(a, b, 100) for a, b, _ in ends], [np.full(100, radius) for *_, radius in ends])


def pictured(system: tubes.Tubes, mu_per_mm: float | None) -> Evidence:
    """Return what the pictures of tubes tell, as opacity, with a little noise."""
    return drawn(system, replace(dark(), mu_per_mm=mu_per_mm), noise=0.005, opacity=True)


STAR = straight(
    ((0.0, 0.0, -25.0), (0.0, 0.0, -55.0), 0.35),
    ((0.0, 0.0, -28.0), (14.0, 2.0, -40.0), 0.1),
    ((0.0, 0.0, -31.0), (-12.0, 9.0, -34.0), 0.15),
    ((0.0, 0.0, -36.0), (2.0, -15.0, -45.0), 0.2),
    ((0.0, 0.0, -40.0), (-9.0, -9.0, -58.0), 0.12),
)
SLANTED = ((-8.0, -6.0, -30.0), (8.0, 6.0, -50.0))
ORGAN = np.zeros(len(STAR.radius_mm), bool)


@pytest.mark.parametrize("tau", [1e-3, 0.1, 1.0, 20.0])
@pytest.mark.parametrize("index", [1.0, 1.024])
def test_strips_have_the_moments_of_a_round_root(tau: float, index: float) -> None:
    found = translucent_tube.layers(tau / 0.5, 0.0, mi.Float(0.5), mi.Float(1.0), mi.Float(1.0), index=index)
    for k in range(2 * translucent_tube.LAYERS):

        def slab(angle: float, power: int = 2 * k) -> float:
            chord = np.sqrt(1.0 - (np.cos(angle) / index) ** 2)
            return float((1.0 - np.exp(-2.0 * tau * chord)) * np.sin(angle) * np.cos(angle) ** power)

        expected = quad(slab, 0.0, np.pi, limit=200)[0]
        moment = sum(2.0 / (2 * k + 1) * layer.half_px[0] ** (2 * k + 1) * layer.height[0] for layer in found)
        assert moment == pytest.approx(expected, rel=3e-5 if index == 1.0 else 2e-4)


def test_a_faint_root_keeps_back_light_by_its_volume() -> None:
    """Beer and Lambert: the optical depth over a picture's area is mu times the volume, from wherever it is seen."""
    mu, radius = 0.5, 0.1
    system, seen = straight((*SLANTED, radius)), replace(dark(), mu_per_mm=mu)
    at = seen.project(system.centre_mm)
    light = 1.0 - np.array(tube_picture.transmittance(seen, system, at)).reshape(seen.bank.count, -1)
    px2_a_mm2 = np.linalg.norm(np.cross(at.du, at.dv), axis=-1).mean(axis=1)
    volume = np.pi * radius**2 * system.length_mm
    np.testing.assert_allclose(light.sum(axis=1) / px2_a_mm2, mu * volume, rtol=0.09)  # less than 2 mu r / sin = 0.1 to 0.16 of saturation


@pytest.mark.parametrize("mu", [None, 2.0])
def test_the_derivative_by_the_radius_is_that_of_the_picture(mu: float | None) -> None:
    system = straight((*SLANTED, 0.25))
    thicker = tubes.with_geometry(system, system.centre_mm, system.radius_mm + 0.01)
    seen = replace(drawn(thicker, replace(dark(), mu_per_mm=mu), opacity=True).with_opacity(), mu_per_mm=mu)
    found = tube_profiles.profiles(Rendering.draw(seen, system)).host()
    inside = np.s_[:, 3:-3]
    ratio = found.width[inside].sum() / (found.width_2 * found.scale)[inside].sum()
    assert ratio == pytest.approx(0.01, rel=0.15)  # the slope is that of a Gaussian pixel
