"""Tubes of translucent roots: the strips that stand for them, their pictures, and the attenuation that pictures tell."""

from dataclasses import replace
from functools import cache

import mitsuba as mi
import numpy as np
import pytest
from scipy.integrate import quad

from rhizotwin.recon.coverage.evidence import Evidence
from rhizotwin.recon.coverage.light import Light
from rhizotwin.recon.tubes import root_light, translucent_tube, tube_attenuation, tube_fit, tube_picture, tube_profiles, tubes
from rhizotwin.recon.tubes.translucent_tube import HAIRS
from rhizotwin.recon.tubes.tube_attenuation import TubeAttenuation
from rhizotwin.recon.tubes.tube_picture import Rendering
from rhizotwin.scenes.model import Camera, CapturePlan, Ring, Scene
from tests.recon.hull.exact_pictures import ring_of
from tests.recon.strings import blank_of, drawn

RINGS = Ring(views=8), Ring(views=8, height_mm=60.0, tilt_deg=15.0)


@cache
def dark() -> Evidence:
    """Return pictures without roots, from two heights."""
    return blank_of(Scene(camera=Camera().resized((400, 300)), plan=CapturePlan(rings=RINGS)))


def straight(*ends: tuple[tuple[float, float, float], tuple[float, float, float], float]) -> tubes.Tubes:
    """Return straight tubes from one point to another, each with a radius."""
    return tubes.place_nodes([np.linspace(a, b, 100) for a, b, _ in ends], [np.full(100, radius) for *_, radius in ends])


def pictured(system: tubes.Tubes, mu_per_mm: float) -> Evidence:
    """Return what the pictures of tubes tell, as opacity, with a little noise."""
    return drawn(system, replace(dark(), light=Light(mu_per_mm)), noise=0.005, opacity=True)


STAR = straight(
    ((0.0, 0.0, -25.0), (0.0, 0.0, -55.0), 0.35),
    ((0.0, 0.0, -28.0), (14.0, 2.0, -40.0), 0.1),
    ((0.0, 0.0, -31.0), (-12.0, 9.0, -34.0), 0.15),
    ((0.0, 0.0, -36.0), (2.0, -15.0, -45.0), 0.2),
    ((0.0, 0.0, -40.0), (-9.0, -9.0, -58.0), 0.12),
)
SLANTED = ((-8.0, -6.0, -30.0), (8.0, 6.0, -50.0))
ORGAN = np.zeros(len(STAR.radius_mm), bool)


@cache
def strips(light: Light, radius_mm: float, sine: float, half_px: float) -> np.ndarray:
    """Return half-width and height of each strip."""
    layers = translucent_tube.layers(light, mi.Float(radius_mm), mi.Float(sine), mi.Float(half_px))
    return np.array([[layer.half_px[0], layer.height[0]] for layer in layers], np.float64).T


def moment(strips: np.ndarray, power: int, scale: float = 1.0) -> float:
    half, height = strips
    return float((2.0 / (power + 1) * (half / scale) ** (power + 1) * height).sum())


@pytest.mark.parametrize("power", range(0, 4 * translucent_tube.LAYERS, 2))
@pytest.mark.parametrize("tau", [1e-3, 1.0, 20.0])
@pytest.mark.parametrize("index", [1.0, 1.024])
def test_strips_have_the_moments_of_a_round_root(power: int, tau: float, index: float) -> None:
    def slab(angle: float) -> float:
        chord = np.sqrt(1.0 - (np.cos(angle) / index) ** 2)
        return float((1.0 - np.exp(-2.0 * tau * chord)) * np.sin(angle) * np.cos(angle) ** power)

    found = strips(Light(tau / 0.5, index=index), 0.5, 1.0, 1.0)
    assert moment(found, power) == pytest.approx(quad(slab, 0.0, np.pi, limit=200)[0], rel=3e-5 if index == 1.0 else 2e-4)


def test_a_faint_root_keeps_back_light_by_its_volume() -> None:
    """Beer and Lambert: the optical depth over a picture's area is mu times the volume, from wherever it is seen."""
    mu, radius = 0.5, 0.1
    system, seen = straight((*SLANTED, radius)), replace(dark(), light=Light(mu))
    at = seen.project(system.centre_mm)
    light = 1.0 - np.array(tube_picture.transmittance(seen, system, at)).reshape(seen.bank.count, -1)
    px2_a_mm2 = np.linalg.norm(np.cross(at.du, at.dv), axis=-1).mean(axis=1)
    volume = np.pi * radius**2 * system.length_mm
    np.testing.assert_allclose(light.sum(axis=1) / px2_a_mm2, mu * volume, rtol=0.09)  # less than 2 mu r / sin = 0.1 to 0.16 of saturation


@pytest.mark.parametrize("mu", [np.inf, 2.0])
def test_the_derivative_by_the_radius_is_that_of_the_picture(mu: float) -> None:
    system = straight((*SLANTED, 0.25))
    thicker = tubes.with_geometry(system, system.centre_mm, system.radius_mm + 0.01)
    lit = replace(dark(), light=Light(mu))
    seen = replace(drawn(thicker, lit, opacity=True), light=lit.light)
    found = tube_profiles.profiles(Rendering.draw(seen, system)).host()
    inside = np.s_[:, 3:-3]
    ratio = found.width[inside].sum() / (found.width_2 * found.scale)[inside].sum()
    assert ratio == pytest.approx(0.01, rel=0.15)  # the slope is that of a Gaussian pixel


CROWD = straight(
    *(((0.0, 0.0, -25.0 - 2.0 * k), (18.0 * np.cos(2.4 * k), 18.0 * np.sin(2.4 * k), -32.0 - 2.4 * k), 0.15 + 0.02 * k) for k in range(14))
)


@pytest.mark.parametrize(("radius", "sine"), [(0.05, 1.0), (2.0, 0.5)])
@pytest.mark.parametrize("mu", [np.inf, 1.0])
@pytest.mark.parametrize("power", [0, 2])
def test_strips_with_hairs_have_the_moments_of_root_and_sleeve(radius: float, sine: float, mu: float, power: int) -> None:
    outer = radius + HAIRS.length_mm

    def dark(x: float) -> float:
        inside = np.sqrt(max(radius**2 - x**2, 0.0))
        sleeve = HAIRS.mu_per_mm * (np.sqrt(outer**2 - x**2) - inside)
        root = 0.0 if x >= radius else mu * inside
        return float(x**power * (1.0 - np.exp(-2.0 * (root + sleeve) / sine)))

    expected = 2.0 * quad(dark, 0.0, outer, points=[radius], limit=200)[0]
    assert moment(strips(Light(mu, hairs=1.0), radius, sine, 4.0 * radius), power, scale=4.0) == pytest.approx(expected, rel=0.02)


@pytest.mark.parametrize("strength", [0.0, 1.0])
def test_pictures_tell_whether_roots_have_hairs(strength: float) -> None:
    """In pictures that are fine enough to show hairs: 0.2 mm a pixel."""
    lens = replace(Camera().resized((1200, 900)), image_wh=(400, 300), principal_px=(199.5, 149.5))  # the middle of the picture
    sharp = blank_of(replace(ring_of(6), camera=lens))
    true = Light(1.0, hairs=strength, index=1.0 + root_light.BENDING[0])
    seen = replace(drawn(CROWD, replace(sharp, light=true), noise=0.003, opacity=True), light=Light(1.0, hairs=0.5))
    fixed = np.zeros(len(CROWD.radius_mm), bool)
    fit = tube_fit.fit(
        seen, root_light.match_absorption(CROWD, fixed, true, seen.light), fixed, steps=10, light=root_light.parameters(seen)
    )
    found = tube_attenuation.update_attenuation(TubeAttenuation.opaque(), fit)
    assert found.hairs == ("there" if strength else "none")
    assert fit.evidence.light.hairs == pytest.approx(strength, abs=0.1)
    assert np.median(fit.tubes.radius_mm / CROWD.radius_mm) == pytest.approx(1.0, abs=0.02)
    assert ("hairs" in " ".join(found.warnings())) == (strength > 0.0)
