"""The attenuation of translucent roots, from profiles that are computed here by themselves."""

import numpy as np
import pytest

from rhizotwin.recon.calibration.cameras import Cameras
from rhizotwin.recon.coverage import measure, silhouettes, translucency
from rhizotwin.recon.coverage.measure import Coverage
from rhizotwin.recon.optics.refraction import Optics
from rhizotwin.scenes.monitor import Monitor
from tests.recon.hull.exact_pictures import ring_of, views_of

PX_A_MM = 4.0
WIDE = (1.2, 1.5, 1.8, 2.2, 2.5)


def picture(mu_per_mm: float, diameters_mm: tuple[float, ...], *, own: float = 0.0, noise: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Opacity and coverage of upright round roots, area-sampled across."""
    fine = (np.arange(240 * 20) + 0.5) / 20.0 - 0.5
    opacity, coverage = np.zeros(len(fine)), np.zeros(len(fine))
    for k, diameter in enumerate(diameters_mm):
        half = np.sqrt(np.maximum((0.5 * diameter) ** 2 - ((fine - 20.3 - 36.4 * k) / PX_A_MM) ** 2, 0.0))
        opacity += (1.0 - own) * (1.0 - np.exp(-2.0 * mu_per_mm * half))
        coverage += half > 0
    rows = [np.repeat(line.reshape(240, 20).mean(axis=1)[None], 60, axis=0).astype(np.float32) for line in (opacity, coverage)]
    rows[0] += np.random.default_rng(0).normal(0.0, noise, rows[0].shape).astype(np.float32)
    return rows[0], rows[1]


def test_resolved_roots_tell_their_attenuation_or_own_brightness() -> None:
    def learned(opacity: np.ndarray) -> translucency.Attenuation:
        return translucency.learn([opacity], [np.ones(opacity.shape, bool)], PX_A_MM)

    assert learned(picture(2.0, WIDE, noise=0.01)[0]).mu_per_mm == pytest.approx(2.0, rel=0.1)
    opaque = learned(picture(1e4, WIDE, own=0.05)[0])
    assert opaque.mu_per_mm is None
    assert opaque.own == pytest.approx(0.05, abs=1e-3)


def test_translucent_roots_get_the_width_they_have() -> None:
    diameters = (0.2, 0.3, 0.45, 0.8, 1.5, 2.2)
    opacity, coverage = picture(2.0, diameters)
    found = translucency.translucent_coverage(opacity, translucency.Attenuation(0.0, 2.0, 100), PX_A_MM)
    widths, true = ([one[30, int(36.4 * k) : int(36.4 * k) + 40].sum() for k in range(len(diameters))] for one in (found, coverage))
    assert widths == pytest.approx(true, rel=0.1)


def test_roots_that_seemed_opaque_get_the_width_they_have() -> None:
    scene = ring_of(1)
    cameras = Cameras.from_views(views_of(scene), Optics.from_scene(scene))
    opacity, coverage = picture(2.0, (0.3, 0.45, 0.8, 1.5))
    mu_per_mm = 2.0 * measure._px_a_mm(cameras) / PX_A_MM  # the same picture at the camera's scale
    seen = np.ones(opacity.shape, bool)
    drawn = silhouettes.measure(opacity, seen)
    drawn = silhouettes.Silhouette(drawn.coverage, seen, opacity.astype(np.float16))
    before = Coverage(silhouettes={0: drawn}, attenuation=translucency.Attenuation(0.0, None, 0))
    found = measure.remeasure_coverage(before, cameras, mu_per_mm, monitor=Monitor())
    assert drawn.coverage.sum() < 0.8 * coverage.sum()
    assert found.silhouettes[0].coverage.sum() == pytest.approx(coverage.sum(), rel=0.1)
    assert measure.remeasure_coverage(found, cameras, 1.1 * mu_per_mm, monitor=Monitor()) is found
    again = measure.remeasure_coverage(found, cameras, None, monitor=Monitor())
    np.testing.assert_allclose(again.silhouettes[0].coverage, drawn.coverage, atol=2e-3)
