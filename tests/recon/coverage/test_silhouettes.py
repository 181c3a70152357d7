"""Silhouettes: outlines to a fraction of a pixel, coverage against a known background, and of translucent roots."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.special import erf

from rhizotwin.recon.coverage import evidence, measure, silhouettes, translucency
from rhizotwin.recon.coverage.measure import Coverage
from rhizotwin.recon.coverage.silhouettes import Silhouette
from rhizotwin.recon.optics.refraction import Optics
from rhizotwin.scenes.monitor import Monitor
from rhizotwin.scoring.baselines import thesis_silhouette
from tests.recon.hull.exact_pictures import cameras_of, ring_of, views_of


def strip(width_px: float, angle: float, offset: float, shape: tuple[int, int] = (96, 128), samples: int = 12) -> np.ndarray:
    """Coverage of a straight strip, area-sampled."""
    h, w = shape
    y, x = (np.mgrid[0 : h * samples, 0 : w * samples] + 0.5) / samples - 0.5
    inside = np.abs((x - w / 2 - offset) * np.cos(angle) + (y - h / 2) * np.sin(angle)) < width_px / 2
    return inside.reshape(h, samples, w, samples).mean(axis=(1, 3)).astype(np.float32)


def outlined_width(coverage: np.ndarray, angle: float) -> float:
    distance = silhouettes.signed_distance(Silhouette(coverage, np.ones(coverage.shape, bool)))
    fine = cv2.resize(distance, None, fx=4, fy=4, interpolation=cv2.INTER_LINEAR)[64:-64]
    return float((fine > 0).mean() * coverage.shape[1] * np.cos(angle))


@pytest.mark.parametrize("width_px", [1.0, 2.0, 12.0])
def test_outline_keeps_the_width_of_strips(width_px: float) -> None:
    drawn = [(strip(width_px, angle, offset, (48, 64)), angle) for angle in (0.0, 0.2, 0.6) for offset in (0.1, 0.35, 0.6)]
    widths = [outlined_width(*one) for one in drawn]
    assert np.mean(widths) == pytest.approx(width_px, rel=0.05 if width_px < 2 else 0.02)


def test_outline_level_matches_the_blurred_strip() -> None:
    """A strip of half-width a under a Gaussian is erf(a / sqrt 2) high in its middle, and half of erf(2 a / sqrt 2) at its edge."""
    half = np.array([0.2, 0.5, 1.0, 3.0]) / np.sqrt(2.0)
    np.testing.assert_allclose(silhouettes.outline_level(erf(half)), 0.5 * erf(2.0 * half), atol=2e-3)


def test_level_distance_of_a_disc_is_the_distance_to_its_circle() -> None:
    """Its middle too is as deep as its radius; a chamfer distance would be 1.7 % short there, and with it the largest sphere."""
    row, column = np.mgrid[:200, :200]
    true = 80.0 - np.hypot(column - 99.3, row - 100.6)
    found = silhouettes.level_distance(np.clip(true, -1.5, 1.5).astype(np.float32))
    assert (np.sign(found) == np.sign(true)).all()
    for near, most in ((np.abs(true) < 0.3, 0.1), (true < 60.0, 0.9), (true > 60.0, 0.35)):
        assert np.abs(found - true)[near].max() < most
    assert abs(float(np.mean((found - true)[true > 60.0]))) < 0.05


def test_where_nothing_is_seen_the_map_says_so() -> None:
    distance = silhouettes.signed_distance(Silhouette(np.zeros((40, 60), np.float32), np.mgrid[:40, :60][1] < 30))
    assert (distance[:, 58:] == silhouettes.UNSEEN_PX).all()
    assert (distance[:, :58] < 0).all()
    assert distance[40, 0] == pytest.approx(-29.5, abs=0.6), "the unseen may hide a root: nothing is ruled out there"


def test_a_speck_before_a_thick_root_changes_no_outline() -> None:
    coverage, seen = strip(40.0, 0.1, 0.0), np.ones((96, 128), bool)
    whole, core = Silhouette(coverage, seen), evidence.core_outline(Silhouette(coverage, seen))
    seen = seen.copy()
    seen[40:52, 58:70] = seen[42:50, 56:72] = seen[39, 60:66] = seen[10:14, 44:48] = False  # one inside, one across the edge
    speck = Silhouette(np.where(seen, coverage, 0.0).astype(np.float32), seen)
    near = np.s_[2 * 30 : 2 * 62, 2 * 50 : 2 * 78]
    for before, outline in ((silhouettes.signed_distance(whole), silhouettes.signed_distance), (core, evidence.core_outline)):
        found = outline(speck)
        told = found[near] < 0.5 * silhouettes.UNSEEN_PX
        assert 0.5 < told.mean() < 1.0
        np.testing.assert_allclose(found[near][told], before[near][told], atol=1e-3)
    assert (silhouettes.signed_distance(speck)[2 * 8 : 2 * 16, :60] < 0).all(), "beside the root nothing is covered"


def test_measured_coverage_is_the_fraction_whatever_the_light() -> None:
    truth = strip(6.0, 0.3, 0.2) + strip(0.8, -0.4, 20.0)
    background = (40000 * np.linspace(0.6, 1.0, truth.shape[1]) * np.ones_like(truth)).astype(np.float32)
    image = (background * (1 - truth) + 3000.0 * truth).astype(np.float32)
    seen = np.ones(truth.shape, bool)
    found = silhouettes.opaque_coverage(silhouettes.opacity(image, background, seen), seen)
    assert np.abs(np.clip(found, 0, 1) - np.clip(truth, 0, 1)).max() < 0.03


def test_thesis_silhouette_joins_thick_and_thin() -> None:
    rng = np.random.default_rng(0)
    truth = np.maximum(strip(20.0, 0.2, -20.0), 0.5 * strip(2.0, 0.2, 30.0))
    image = (40000 * (1 - truth) + rng.normal(0, 200, truth.shape)).astype(np.float32)
    found = thesis_silhouette(image, np.ones(truth.shape, bool)).coverage
    assert set(np.unique(found)) == {0.0, 1.0}
    assert found[truth > 0.9].mean() > 0.99, "the inside of the thick root is filled"
    assert found[48, 70:110].any(), "the thin, bright root is kept"
    assert found[:, :10].mean() < 0.02


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
    assert opaque.mu_per_mm == np.inf
    assert opaque.own == pytest.approx(0.05, abs=1e-3)


def test_translucent_roots_get_the_width_they_have() -> None:
    diameters = (0.2, 0.3, 0.45, 0.8, 1.5, 2.2)
    opacity, coverage = picture(2.0, diameters)
    found = translucency.Attenuation(0.0, 2.0).coverage(opacity, np.ones(opacity.shape, bool), PX_A_MM)
    widths, true = ([one[30, int(36.4 * k) : int(36.4 * k) + 40].sum() for k in range(len(diameters))] for one in (found, coverage))
    assert widths == pytest.approx(true, rel=0.1)


def test_roots_that_seemed_opaque_get_the_width_they_have() -> None:
    scene = ring_of(1)
    cameras = cameras_of(views_of(scene), Optics.from_scene(scene))
    opacity, coverage = picture(2.0, (0.3, 0.45, 0.8, 1.5))
    mu_per_mm = 2.0 * measure._px_a_mm(cameras) / PX_A_MM  # the same picture at the camera's scale
    seen = np.ones(opacity.shape, bool)
    drawn = silhouettes.suppress_noise(silhouettes.opaque_coverage(opacity, seen), opacity, seen)
    drawn = replace(drawn, opacity=opacity.astype(np.float16))
    before = Coverage(silhouettes={0: drawn}, attenuation=translucency.Attenuation())
    found = measure.remeasure_coverage(before, cameras, mu_per_mm, monitor=Monitor())
    assert drawn.coverage.sum() < 0.8 * coverage.sum()
    assert found.silhouettes[0].coverage.sum() == pytest.approx(coverage.sum(), rel=0.1)
    assert measure.remeasure_coverage(found, cameras, 1.1 * mu_per_mm, monitor=Monitor()) is found
    again = measure.remeasure_coverage(found, cameras, np.inf, monitor=Monitor())
    np.testing.assert_allclose(again.silhouettes[0].coverage, drawn.coverage, atol=2e-3)
