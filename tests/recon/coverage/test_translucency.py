"""The attenuation of translucent roots, from profiles that are computed here by themselves."""

import numpy as np
import pytest

from rhizotwin.recon.coverage import translucency

PX_A_MM = 4.0


def picture(mu_per_mm: float, diameters_mm: tuple[float, ...], *, own: float = 0.0, noise: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Opacity and coverage of upright round roots, area-sampled across."""
    fine = (np.arange(240 * 20) + 0.5) / 20.0 - 0.5
    opacity, coverage = np.zeros(len(fine)), np.zeros(len(fine))
    for k, diameter in enumerate(diameters_mm):
        half = np.sqrt(np.maximum((0.5 * diameter) ** 2 - ((fine - 20.3 - 36.4 * k) / PX_A_MM) ** 2, 0.0))
        opacity += (1.0 - own) * (1.0 - np.exp(-2.0 * mu_per_mm * half))
        coverage += half > 0
    rows = [np.repeat(line.reshape(240, 20).mean(axis=1)[None], 120, axis=0).astype(np.float32) for line in (opacity, coverage)]
    rows[0] += np.random.default_rng(0).normal(0.0, noise, rows[0].shape).astype(np.float32)
    return rows[0], rows[1]


@pytest.mark.parametrize("mu", [1.0, 2.0])
def test_the_attenuation_comes_from_resolved_roots(mu: float) -> None:
    opacity, _ = picture(mu, (1.2, 1.5, 1.8, 2.2, 2.5), noise=0.01)
    attenuation = translucency.learn([opacity], [np.ones(opacity.shape, bool)], PX_A_MM)
    assert attenuation.mu_per_mm == pytest.approx(mu, rel=0.1)


def test_opaque_roots_stay_opaque_and_show_their_own_brightness() -> None:
    opacity, _ = picture(1e4, (1.2, 1.5, 1.8, 2.2, 2.5), own=0.05)
    attenuation = translucency.learn([opacity], [np.ones(opacity.shape, bool)], PX_A_MM)
    assert attenuation.mu_per_mm is None
    assert attenuation.own == pytest.approx(0.05, abs=1e-3)


def test_nothing_is_learnt_from_an_empty_picture() -> None:
    empty = np.zeros((60, 80), np.float32)
    attenuation = translucency.learn([empty], [np.ones(empty.shape, bool)], PX_A_MM)
    assert (attenuation.mu_per_mm, attenuation.own, attenuation.profiles) == (None, 0.0, 0)


def test_translucent_roots_get_the_width_they_have() -> None:
    diameters = (0.2, 0.3, 0.45, 0.8, 1.5, 2.2)
    opacity, coverage = picture(2.0, diameters)
    found = translucency.covered(opacity, translucency.Attenuation(0.0, 2.0, 100), PX_A_MM)
    for k in range(len(diameters)):
        part = np.s_[60, int(36.4 * k) : int(36.4 * k) + 40]
        assert found[part].sum() == pytest.approx(coverage[part].sum(), rel=0.1)
