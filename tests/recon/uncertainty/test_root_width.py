"""The width of roots in pictures, and what coarse pictures are the cause of."""

import cv2
import numpy as np
import pytest

from rhizotwin.recon.coverage.silhouettes import Silhouette
from rhizotwin.recon.settings import TrustSettings
from rhizotwin.recon.uncertainty import checks, picture_checks, root_width, shape_checks


def lines(width_px: float, blur_px: float = 0.0) -> Silhouette:
    """Draw lines of a width in eight directions, sampled sixteen times a pixel."""
    fine = np.zeros((1600, 1600), np.uint8)
    for k in range(8):
        along = np.array([np.cos(k * np.pi / 8 + 0.1), np.sin(k * np.pi / 8 + 0.1)])
        ends = [tuple((800.0 + side * 700.0 * along).astype(int).tolist()) for side in (0.15, 1.0)]
        cv2.line(fine, *ends, 1, max(1, round(16 * width_px)))
    coverage = cv2.resize(fine.astype(np.float32), (100, 100), interpolation=cv2.INTER_AREA)
    coverage = cv2.GaussianBlur(coverage, (0, 0), blur_px) if blur_px else coverage
    return Silhouette(coverage, np.ones(coverage.shape, bool))


@pytest.mark.parametrize("width_px", [0.5, 1.0, 2.0])
def test_width_of_lone_lines(width_px: float) -> None:
    assert root_width.thin_width_px([lines(width_px)]) == pytest.approx(width_px, rel=0.2)


def test_no_lines() -> None:
    assert root_width.thin_width_px([Silhouette(np.zeros((20, 20), np.float32), np.ones((20, 20), bool))]) is None


@pytest.mark.parametrize(("width_px", "state"), [(0.61, "fair"), (0.75, "good"), (None, "unknown")])
def test_state(width_px: float | None, state: str) -> None:
    assert picture_checks.check_resolution(width_px, (400, 300)).state == state


def test_coarse_pictures_are_the_cause_of_views_that_disagree() -> None:
    thin = picture_checks.check_resolution(0.6, (400, 300))
    disagree = shape_checks.check_agreement(missed=0.345, unexplained=0.0, fill=0.1)
    sharp = picture_checks.check_resolution(2.0, (400, 300))
    said = checks.failure_reasons(checks.name_cause((thin, disagree)))
    assert len(said) == 1
    assert "thinner than 0.6 px, so that the views disagree on 34.5 %" in said[0]
    assert "at least 670 pixels wide" in said[0]
    assert "nothing moved" not in said[0]
    assert checks.name_cause((sharp, disagree)) == (sharp, disagree)
    assert TrustSettings().resolution_px[1] == 0.0
