"""Attenuation, blur and hairs, fitted together with the tubes."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from rhizotwin.recon.coverage.evidence import Evidence
from rhizotwin.recon.coverage.light import LIGHT, Light
from rhizotwin.recon.tubes import root_light, tube_attenuation, tube_fit, tube_profiles
from rhizotwin.recon.tubes.parameters import Parameters
from rhizotwin.recon.tubes.tube_picture import Rendering
from rhizotwin.recon.tubes.tubes import Tubes
from tests.recon.strings import drawn
from tests.recon.tubes.test_translucent_tubes import ORGAN, SLANTED, STAR, dark, pictured, straight

STEPS = np.array([0.02, 0.01, 0.05, 0.004])


def bald(seen: Evidence) -> Parameters:
    """Return attenuation and blur alone as free parameters."""
    return replace(root_light.parameters(seen), free=np.array([True, True, False, False]))


def blurred(noise: float, seed: int = 0) -> Evidence:
    """Return pictures of the star with an attenuation of 2 / mm and a blur of 0.4 px, both of which are known."""
    true = Light(2.0, 0.4)
    return replace(drawn(STAR, replace(dark(), light=true), noise=noise, opacity=True, seed=seed), light=true)


@pytest.mark.parametrize("column", range(4), ids=LIGHT)
def test_columns_are_derivatives_of_the_picture(column: int) -> None:
    """Along the column, the gradient of what a small change leaves is the change times the squared derivative."""
    system = straight((*SLANTED, 0.25))
    seen = replace(dark(), light=Light(2.0, 0.4, 1.0, 1.02))
    changed = replace(seen, light=Light.from_vector(seen.light.vector + STEPS * np.eye(4)[column]))
    seen = replace(seen, opacity=drawn(system, changed, opacity=True).opacity)
    now = Rendering.draw(seen, system)
    ends = np.isin(np.arange(len(system.radius_mm)), np.arange(-3, 3) % len(system.radius_mm))
    _, found = tube_profiles.profiles(now, root_light.changes(now, np.arange(4) == column)).light_equations(ends)
    ratio = found.right[column] / found.whole[column, column]
    assert ratio == pytest.approx(STEPS[column], rel=0.15)  # the slope is that of a Gaussian pixel


def test_the_fit_goes_down_the_valley_of_attenuation_and_blur() -> None:
    """From twice the attenuation and half the blur, which look alike within some per cent."""
    seen = replace(blurred(0.005), light=Light(4.0, 0.2))
    start = root_light.match_absorption(STAR, ORGAN, Light(2.0, 0.4), seen.light)
    fit = tube_fit.fit(seen, start, ORGAN, steps=14, light=bald(seen))
    assert fit.evidence.light.mu_per_mm == pytest.approx(2.0, rel=0.05)
    assert fit.evidence.light.blur_px == pytest.approx(0.4, abs=0.02)
    assert np.median(fit.tubes.radius_mm / STAR.radius_mm) == pytest.approx(1.0, abs=0.03)


@cache
def begun(mu: float) -> tuple[Evidence, Tubes]:
    """Return pictures of the star, and opaque tubes that absorb as much light."""
    return pictured(STAR, mu), root_light.match_absorption(STAR, ORGAN, Light(mu), Light())


@pytest.mark.parametrize(("mu", "error"), [(np.inf, 0.02), (2.0, 0.08)])
def test_pictures_tell_opaque_roots_from_translucent_ones(mu: float, error: float) -> None:
    attenuation, fit = tube_attenuation.find(*begun(mu), ORGAN)
    assert attenuation.light.is_opaque == Light(mu).is_opaque
    assert np.median(fit.tubes.radius_mm / STAR.radius_mm) == pytest.approx(1.0, abs=error)


def test_where_tubes_are_few_wide_roots_tell_the_attenuation(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (tube_attenuation, tube_fit):
        monkeypatch.setattr(module, "LEAST_LONE", 10**9)
    assert tube_attenuation.find(*begun(2.0), ORGAN)[0].light.is_opaque
    attenuation = tube_attenuation.update_attenuation(*tube_attenuation.find(*begun(2.0), ORGAN, 2.0))
    assert attenuation.light.mu_per_mm == pytest.approx(2.0, rel=0.1)
    assert attenuation.sigma == root_light.LEARNED_SIGMA


def test_the_covariance_is_the_scatter_over_noise(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of the step from the true light, for a model without error: five roots are few clusters, so that it is known to a third."""
    monkeypatch.setattr(root_light, "LEAST_VARIANCE", 1e-9)
    steps, sigmas = [], []
    for seed in range(8):
        seen = blurred(0.02, seed)
        fit = tube_fit.fit(seen, STAR, ORGAN, steps=1, light=bald(seen))
        steps.append(fit.evidence.light.vector[:2] - seen.light.vector[:2])
        sigmas.append(np.sqrt(np.diag(fit.lit.solve(bald(seen))[1]))[:2])
    assert np.abs(np.mean(steps, axis=0)).max() < 0.03
    np.testing.assert_allclose(np.sqrt(np.mean(np.square(sigmas), axis=0)), np.std(steps, axis=0), rtol=0.6)


def test_an_error_of_the_model_does_not_average_out() -> None:
    """The covariance is that of the light parameters if the error of the coverage is the same in all profiles."""
    seen = blurred(1e-4)
    system = tube_fit.fit(seen, STAR, ORGAN, steps=1, light=bald(seen)).lit
    worst = np.sqrt(np.diag(system.solve(bald(seen))[1]))[:2]
    per_profile = system.system.reduced[:2, :2] / system.lone
    np.testing.assert_allclose(worst, np.sqrt(root_light.LEAST_VARIANCE * np.diag(np.linalg.inv(per_profile))), rtol=0.1)
