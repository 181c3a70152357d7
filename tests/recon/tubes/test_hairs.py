"""Root hairs: the strip that stands for their sleeve, and whether pictures of tubes tell of them."""

from dataclasses import replace

import mitsuba as mi
import numpy as np
import pytest
from scipy.integrate import quad

from rhizotwin.recon.tubes import root_light, translucent_tube, tube_attenuation, tube_fit
from rhizotwin.recon.tubes.root_light import Prior
from rhizotwin.recon.tubes.translucent_tube import HAIRS
from rhizotwin.recon.tubes.tube_attenuation import TubeAttenuation
from rhizotwin.scenes.model import Camera, CapturePlan, Ring, Scene
from tests.recon.strings import blank_of, drawn
from tests.recon.tubes.test_translucent_tubes import straight

CROWD = straight(
    *(((0.0, 0.0, -25.0 - 2.0 * k), (18.0 * np.cos(2.4 * k), 18.0 * np.sin(2.4 * k), -32.0 - 2.4 * k), 0.15 + 0.02 * k) for k in range(14))
)
FAINT = 2e-3


@pytest.mark.parametrize(("radius", "sine"), [(0.05, 1.0), (0.5, 1.0), (2.0, 0.5)])
@pytest.mark.parametrize("mu", [None, 1.0])
def test_strips_with_hairs_have_the_moments_of_the_root_in_its_sleeve(radius: float, sine: float, mu: float | None) -> None:
    outer, strength = radius + HAIRS.length_mm, 1.0
    found = translucent_tube.layers(mu, strength, mi.Float(radius), mi.Float(sine), mi.Float(4.0 * radius))
    for k in range(2):

        def dark(x: float, power: int = 2 * k) -> float:
            inside = np.sqrt(max(radius**2 - x**2, 0.0))
            sleeve = strength * HAIRS.mu_per_mm * (np.sqrt(outer**2 - x**2) - inside)
            root = 0.0 if x >= radius else np.inf if mu is None else mu * inside
            return float(x**power * (1.0 - np.exp(-2.0 * (root + sleeve) / sine)))

        expected = 2.0 * quad(dark, 0.0, outer, points=[radius], limit=200)[0]
        moments = (2.0 * (layer.half_px[0] / 4.0) ** (2 * k + 1) / (2 * k + 1) * layer.height[0] for layer in found)
        assert float(sum(moments)) == pytest.approx(expected, rel=0.02)


@pytest.mark.parametrize(("mu", "hairs"), [(None, 1.0), (2.0, 0.0), (2.0, 1.0)])
def test_slopes_of_strips_are_derivatives(mu: float | None, hairs: float) -> None:
    radius, scale, step = 0.3, 4.0, 1e-3

    def at(mm: float) -> list[translucent_tube.Layer]:
        return translucent_tube.layers(mu, hairs, mi.Float(mm), mi.Float(0.8), mi.Float(scale * mm))

    for now, more, less in zip(at(radius), at(radius + step), at(radius - step), strict=True):
        change = 2.0 * scale * step
        assert float(now.by_width[0]) == pytest.approx(now.height[0] * (more.half_px[0] - less.half_px[0]) / change, rel=0.01)
        assert float(now.by_height[0]) == pytest.approx((more.height[0] - less.height[0]) / change, abs=2e-3)


@pytest.mark.parametrize("hairs", [0.0, 1.0])
@pytest.mark.parametrize("mu", [None, 2.0])
def test_radii_that_keep_back_as_much_light_are_found_again(mu: float | None, hairs: float) -> None:
    radius = np.array([0.05, 0.1, 0.4, 2.0])
    light = translucent_tube.opaque_radius(radius, mu, hairs)
    assert not hairs or (light > translucent_tube.opaque_radius(radius, mu)).all()
    np.testing.assert_allclose(translucent_tube.equivalent_radius(light, mu, hairs), radius, rtol=1e-3)


@pytest.mark.parametrize("strength", [0.0, 1.0])
def test_pictures_tell_whether_roots_have_hairs_which_are_not_counted_as_root(strength: float) -> None:
    """In pictures that are fine enough to show hairs: 0.2 mm a pixel."""
    sharp = blank_of(Scene(camera=Camera().resized((1200, 900)), plan=CapturePlan(rings=(Ring(views=6),))))
    true = replace(sharp, mu_per_mm=1.0, hairs=strength, index=1.0 + root_light.BENDING[0])
    seen = replace(drawn(CROWD, true, noise=0.003, opacity=True).with_opacity(), mu_per_mm=1.0, hairs=0.5)
    fixed = np.zeros(len(CROWD.radius_mm), bool)
    fit = tube_fit.fit(seen, root_light.match_absorption(CROWD, fixed, true, seen), fixed, steps=10, light=Prior.from_evidence(seen))
    found = tube_attenuation.update_attenuation(TubeAttenuation.opaque(), fit)
    assert found.hairs == ("there" if strength else "none")
    assert fit.evidence.hairs == pytest.approx(strength, abs=0.1)
    assert np.median(fit.tubes.radius_mm / CROWD.radius_mm) == pytest.approx(1.0, abs=0.02)
    assert ("hairs" in " ".join(found.warnings())) == (strength > 0.0)
