"""The width of roots in pictures, and what coarse pictures are the cause of."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from rhizotwin.recon.coverage.silhouettes import Silhouette
from rhizotwin.recon.uncertainty import checks, picture_checks, root_width, scattered_light, shape_checks


def lines(width_px: float) -> Silhouette:
    """Draw lines of a width in eight directions, sampled sixteen times a pixel."""
    fine = np.zeros((1600, 1600), np.uint8)
    for k in range(8):
        along = np.array([np.cos(k * np.pi / 8 + 0.1), np.sin(k * np.pi / 8 + 0.1)])
        ends = [tuple((800.0 + side * 700.0 * along).astype(int).tolist()) for side in (0.15, 1.0)]
        cv2.line(fine, *ends, 1, max(1, round(16 * width_px)))
    coverage = cv2.resize(fine.astype(np.float32), (100, 100), interpolation=cv2.INTER_AREA)
    return Silhouette(coverage, np.ones(coverage.shape, bool))


def test_width_of_lone_lines() -> None:
    assert [root_width.thin_width_px([lines(px)]) for px in (0.5, 1.0, 2.0)] == [pytest.approx(px, rel=0.2) for px in (0.5, 1.0, 2.0)]
    assert root_width.thin_width_px([Silhouette(np.zeros((20, 20), np.float32), np.ones((20, 20), bool))]) is None
    assert [picture_checks.check_resolution(px, (400, 300)).state for px in (0.61, 0.75, None)] == ["fair", "good", "unknown"]


def test_coarse_pictures_are_the_cause_of_views_that_disagree() -> None:
    thin = picture_checks.check_resolution(0.6, (400, 300))
    disagree = shape_checks.check_agreement(missed=0.345, unexplained=0.0, fill=0.1)
    sharp = picture_checks.check_resolution(2.0, (400, 300))
    said = checks.failure_reasons(checks.name_cause((thin, disagree)))
    assert len(said) == 1
    assert "thinner than 0.6 px, so that the views disagree on 34.5 %" in said[0]
    assert "nothing moved" not in said[0]
    assert checks.name_cause((sharp, disagree)) == (sharp, disagree)


def views(spread: float, wide_px: float, *, noise: float = 0.02, fine: bool = False) -> list[Silhouette]:
    """Draw trees of a trunk with branches, whose darkness is spread."""
    made = []
    for k in range(6):
        rng = np.random.default_rng(k)
        root = np.zeros((200, 260), np.uint8)
        cv2.line(root, (130, 10), (130, 170), 255, 14)
        for _ in range(8):
            row, reach = int(rng.integers(40, 160)), int(rng.integers(-90, 90))
            cv2.line(root, (130, row), (130 + reach, min(195, row + 40)), 255, 4)
        coverage = (root / 255.0).astype(np.float32)
        opacity = (1.0 - spread) * coverage + spread * cv2.GaussianBlur(coverage, (0, 0), wide_px)
        if fine:  # thin roots near the others
            for _ in range(30):
                row = int(rng.integers(30, 170))
                thin = np.zeros_like(root)
                cv2.line(thin, (130, row), (130 + int(rng.integers(-60, 60)), row + int(rng.integers(-20, 25))), 80, 1)
                opacity = np.maximum(opacity, thin / 255.0)
        opacity = opacity + rng.normal(0.0, noise, opacity.shape)
        made.append(Silhouette(coverage, np.ones(root.shape, bool), opacity.astype(np.float16)))
    return made


@pytest.mark.parametrize(("spread", "wide_px"), [(0.1, 8.0), (0.25, 20.0), (-0.1, 12.0)])
def test_what_is_spread_is_found(spread: float, wide_px: float) -> None:
    assert 0.75 < scattered_light.scattered_fraction(views(spread, wide_px), [(0, 0)] * 6) / spread < 1.15


def test_thin_roots_and_a_backlight_known_worse_are_no_halo() -> None:
    """Half a percent too bright where roots are in most views: the views that have none there tell it apart."""
    drawn = views(0.0, 20.0)
    often = cv2.GaussianBlur(np.mean([one.coverage for one in drawn], axis=0), (0, 0), 12.0)
    worse = [replace(one, opacity=(one.opacity + 0.05 * often).astype(np.float16)) for one in drawn]
    assert max(abs(scattered_light.scattered_fraction(made, [(0, 0)] * 6)) for made in (views(0.0, 20.0, fine=True), worse)) < 0.012
    empty = Silhouette(np.zeros((100, 100), np.float32), np.ones((100, 100), bool))
    untold = [scattered_light.scattered_fraction([replace(empty, opacity=of)], [(0, 0)]) for of in (None, np.zeros((100, 100), np.float16))]
    assert untold == [None, None]
