"""The pictures' curve from markers' edges: markers drawn in closed form, blurred in light, then bent by known curves."""

from functools import cache

import cv2
import numpy as np
import pytest

from rhizotwin.recon.calibration import curve
from rhizotwin.recon.calibration.markers import Markers, detect_markers
from rhizotwin.scenes import transfer
from rhizotwin.scenes.model import MarkerStrip
from rhizotwin.scenes.transfer import LINEAR, SRGB, Curve

STRIP = MarkerStrip()
FINE = 8


@cache
def light_of_markers() -> np.ndarray:
    """Draw eighteen markers, turned a little, as light: black 0.04, white 0.5, noise of 8000 electrons."""
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    fine = np.full((300 * FINE, 420 * FINE), 0.5, np.float32)
    for k in range(18):
        marker = np.where(cv2.aruco.generateImageMarker(dictionary, k, 8) > 127, 0.5, 0.04).astype(np.float32)
        turn, scale = np.deg2rad(3.0 * k - 20.0), 41.3 * FINE / 8.0
        middle = FINE * (np.array([40.3, 50.7]) + 68.0 * np.array([k % 6, k // 6]) * [1.0, 1.3])
        rotated = scale * np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        map_ = np.column_stack([rotated, middle - rotated @ [3.5, 3.5]])
        cv2.warpAffine(marker, map_, fine.shape[::-1], dst=fine, flags=cv2.INTER_NEAREST, borderMode=cv2.BORDER_TRANSPARENT)
    light = cv2.GaussianBlur(fine, (0, 0), 0.7 * FINE).reshape(300, FINE, 420, FINE).mean(axis=(1, 3))
    return np.asarray(np.random.default_rng(0).poisson(light * 8000.0) / 8000.0)


@cache
def markers_of(true: Curve, read: Curve) -> list[Markers]:
    numbers = np.rint(255.0 * true.number(np.clip(light_of_markers(), 0.0, 1.0))).astype(np.uint8)
    return [detect_markers(read.decode(numbers), STRIP)]


def test_the_right_curve_leaves_no_bend_and_a_wrong_one_half_way() -> None:
    assert curve.median_bend(markers_of(transfer.power(1.8), transfer.power(1.8))) == (pytest.approx(0.0, abs=0.005), 18)
    dark, half, white = SRGB.number(np.array([0.04, 0.27, 0.5]))
    expected = (half - 0.5 * (dark + white)) / (white - dark)
    assert curve.median_bend(markers_of(SRGB, LINEAR))[0] == pytest.approx(expected, abs=0.03)  # greys beyond half-way bend otherwise


@pytest.mark.parametrize(
    ("true", "stated", "expected"),
    [(SRGB, LINEAR, SRGB), (LINEAR, SRGB, LINEAR), (SRGB, SRGB, SRGB)],
    ids=["srgb taken for light", "light taken for srgb", "as stated"],
)
def test_a_false_statement_is_corrected(true: Curve, stated: Curve, expected: Curve) -> None:
    found = curve.find(markers_of(true, stated), stated, lambda other: markers_of(true, other))
    assert found.curve.same(expected)
    assert found.is_known
    assert (found.warning is None) == (true is stated)


def test_a_curve_that_nobody_knows_is_measured_and_said() -> None:
    true = transfer.power(1.5)
    found = curve.find(markers_of(true, LINEAR), LINEAR, lambda other: markers_of(true, other))
    assert not found.is_known
    levels = np.linspace(0.3, 0.7, 9)
    np.testing.assert_allclose(found.curve.of(levels), true.of(levels), atol=0.02)
