"""Tubes of translucent roots: the strips that stand for them, their pictures, and the attenuation that pictures tell."""

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from scipy.integrate import quad

from rhizotwin.recon.coverage.evidence import Evidence
from rhizotwin.recon.tubes import attenuation_trials, translucent_tube, tube_attenuation, tube_picture, tube_profiles, tubes
from rhizotwin.scenes.model import Camera, CapturePlan, Ring, Scene
from tests.recon.strings import blank_of, drawn

RINGS = Ring(views=8), Ring(views=8, height_mm=60.0, tilt_deg=15.0)


@cache
def dark() -> Evidence:
    """Return pictures without roots, from two heights."""
    return blank_of(Scene(camera=Camera().resized((400, 300)), plan=CapturePlan(rings=RINGS)))


def straight(*ends: tuple[tuple[float, float, float], tuple[float, float, float], float]) -> tubes.Tubes:
    """Return straight tubes from one point to another, each with a radius."""
    return tubes.string([np.linspace(a, b, 100) for a, b, _ in ends], [np.full(100, radius) for *_, radius in ends])


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
def test_strips_have_the_moments_of_a_round_root(tau: float) -> None:
    found = translucent_tube.strips(np.array(tau))
    for k in range(2 * translucent_tube.LAYERS):

        def slab(angle: float, power: int = 2 * k) -> float:
            return float((1.0 - np.exp(-2.0 * tau * np.sin(angle))) * np.sin(angle) * np.cos(angle) ** power)

        expected = quad(slab, 0.0, np.pi, limit=200)[0]
        assert (2.0 / (2 * k + 1) * found.width ** (2 * k + 1) * found.height).sum() == pytest.approx(expected, rel=3e-5)


def test_layers_of_the_kernel_are_the_strips() -> None:
    mu, radius, sine = 2.0, np.geomspace(0.02, 3.0, 50), np.linspace(0.01, 1.0, 50)
    strips = translucent_tube.strips(mu * radius / np.maximum(sine, translucent_tube.LEAST_SINE))
    found = translucent_tube.layers(mu, None, mi.Float(radius), mi.Float(sine), mi.Float(10.0 * radius))
    w = 10.0 * radius
    for n, layer in enumerate(found):
        dr.eval(layer.half_px, layer.height, layer.by_width, layer.by_height)
        e, h = strips.width[n], strips.height[n]
        np.testing.assert_allclose(np.array(layer.half_px), w * e, rtol=2e-5)
        np.testing.assert_allclose(np.array(layer.height), h, rtol=1e-4, atol=1e-6)
        np.testing.assert_allclose(np.array(layer.by_width), h * (e + strips.width_slope[n]), rtol=1e-3, atol=1e-5)
        np.testing.assert_allclose(np.array(layer.by_height), strips.height_slope[n] / w, rtol=1e-3, atol=1e-4)


def test_a_faint_root_keeps_back_light_by_its_volume() -> None:
    """Beer and Lambert: the optical depth over a picture's area is mu times the volume, from wherever it is seen."""
    mu, radius = 0.5, 0.1
    system, seen = straight((*SLANTED, radius)), replace(dark(), mu_per_mm=mu)
    at = seen.project(system.centre_mm)
    light = 1.0 - np.exp(-np.array(tube_picture.optical_depth(seen, system, at, 0.0)).reshape(seen.bank.count, -1))
    px2_a_mm2 = np.linalg.norm(np.cross(at.du, at.dv), axis=-1).mean(axis=1)
    volume = np.pi * radius**2 * system.length_mm
    np.testing.assert_allclose(light.sum(axis=1) / px2_a_mm2, mu * volume, rtol=0.09)  # less than 2 mu r / sin = 0.1 to 0.16 of saturation


@pytest.mark.parametrize("mu", [None, 2.0])
def test_the_derivative_by_the_radius_is_that_of_the_picture(mu: float | None) -> None:
    system = straight((*SLANTED, 0.25))
    thicker = tubes.moved(system, system.centre_mm, system.radius_mm + 0.01)
    seen = replace(drawn(thicker, replace(dark(), mu_per_mm=mu), opacity=True).by_light(), mu_per_mm=mu)
    at = seen.project(system.centre_mm)
    depth = tube_picture.optical_depth(seen, system, at, 0.0)
    found = tube_profiles.profiles(seen, system, at, depth, tube_picture.unexplained(seen, depth), 0.0).host()
    inside = np.s_[:, 3:-3]
    ratio = found.width[inside].sum() / (found.width_2 * found.scale)[inside].sum()
    assert ratio == pytest.approx(0.01, rel=0.15)  # the slope is that of a Gaussian pixel


def test_tubes_tell_the_attenuation(monkeypatch: pytest.MonkeyPatch) -> None:
    seen, start = pictured(STAR, 2.0), attenuation_trials.scaled(STAR, ORGAN, 2.0, None)
    attenuation, found = tube_attenuation.find(seen, start, ORGAN, 0.0)
    assert attenuation.mu_per_mm == pytest.approx(2.0, rel=0.1)
    assert np.median(found.radius_mm / STAR.radius_mm) == pytest.approx(1.0, abs=0.08)
    light = replace(seen.by_light(), mu_per_mm=attenuation.mu_per_mm)
    again, _ = tube_attenuation.refine(light, found, ORGAN, attenuation)
    assert abs(np.log(again.mu_per_mm / 2.0)) < 3.0 * again.sigma < 0.45
    monkeypatch.setattr(tube_attenuation, "_LEAST_LONE", 10**9)  # too few tubes: as the widest roots seemed
    assert tube_attenuation.find(seen, start, ORGAN, 0.0)[0].mu_per_mm is None
    attenuation, found = tube_attenuation.find(seen, start, ORGAN, 0.0, 2.0)
    assert (attenuation.mu_per_mm, attenuation.sigma) == (2.0, tube_attenuation._LEARNED_SIGMA)
    assert np.median(found.radius_mm / STAR.radius_mm) == pytest.approx(1.0, abs=0.05)


def test_opaque_tubes_are_opaque_at_rest_even_if_taken_for_translucent() -> None:
    pictures = pictured(STAR, None)
    attenuation, found = tube_attenuation.find(pictures, STAR, ORGAN, 0.0)
    assert attenuation.mu_per_mm is None
    assert found is STAR
    seen = replace(pictures.by_light(), mu_per_mm=4.3)
    wrong = tube_attenuation.TubeAttenuation(mu_per_mm=4.3, sigma=0.05, blur_px=0.0, against_opaque=1.37, profiles=1193)
    attenuation, found = tube_attenuation.refine(seen, attenuation_trials.scaled(STAR, ORGAN, None, 4.3), ORGAN, wrong)
    assert attenuation.mu_per_mm is None
    assert np.median(found.radius_mm / STAR.radius_mm) == pytest.approx(1.0, abs=0.03)


@pytest.mark.parametrize(("shared", "expected"), [(False, 0.7), (True, 1.0)], ids=["views and roots", "roots alone"])
def test_what_only_scatters_is_not_told_apart(shared: bool, expected: float) -> None:
    """Both count, on the safe side by the root of two; errors that a root has in all views tell no more for being seen often."""
    roots, nodes, views, rng = 16, 10, 25, np.random.default_rng(3)
    shape = views, roots * nodes
    trials = attenuation_trials.Trials(None, None, None, SimpleNamespace(owner=np.repeat(np.arange(roots), nodes)), np.ones(shape, bool))
    of_roots = [np.tile(np.repeat(rng.normal(size=roots), nodes), (views, 1)) for _ in range(200)]
    losses = [loss if shared else rng.normal(size=shape) for loss in of_roots]
    made = [attenuation_trials.Trial(1.0, 0.0, None, loss, float(loss.sum())) for loss in (np.zeros(shape), *losses)]
    found = [trials.significance(one, made[0]) for one in made[1:]]
    assert np.std(found) == pytest.approx(expected, abs=0.15)
    assert abs(np.mean(found)) < 0.2
