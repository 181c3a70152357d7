"""Exposures told by the bare panel, each as was drawn, and the pictures' curve told by markers' edges that are bent by known curves."""

from dataclasses import replace
from functools import cache
from itertools import chain

import cv2
import numpy as np
import pytest

from rhizotwin.recon.calibration import curve, exposure
from rhizotwin.recon.calibration.markers import Markers, detect_markers
from rhizotwin.recon.optics.cameras import View
from rhizotwin.recon.optics.refraction import Optics
from rhizotwin.scenes import frames, transfer
from rhizotwin.scenes.model import MarkerStrip, Scene
from rhizotwin.scenes.transfer import LINEAR, SRGB, Curve

SCENE = replace(Scene(), camera=Scene().camera.resized((400, 300)))
GAINS = np.array([1.0, 0.9, 1.1, 1.03, 0.97])


def views(count: int) -> list[View]:
    cam_from_rig = frames.level_camera(distance_mm=400.0, height_mm=-42.0, tilt_deg=0.0)
    return [View(camera=SCENE.camera, cam_from_canister=cam_from_rig @ frames.rotation_z(float(k))) for k in range(count)]


def pictures(level: float = 0.6, width: float = 1.0) -> list[np.ndarray]:
    """Draw an uneven panel, with a canister before it that is another in each picture; the panel covers ``width`` of the picture."""
    rng = np.random.default_rng(3)
    x = np.linspace(-1.0, 1.0, 400)[None, :]
    panel = np.where(np.abs(x) < width, level * (1.0 - 0.2 * x**2), 0.004) * np.ones((300, 1))
    found = []
    for gain in GAINS:
        light = np.where(np.abs(x) < 0.63, rng.uniform(0.0, 1.0, (300, 400)) * panel, panel) * gain
        found.append(np.rint(65535.0 * np.clip(light + rng.normal(0.0, 0.004, light.shape), 0.0, 1.0)).astype(np.uint16))
    return found


def measured(*placed: list[np.ndarray]) -> exposure.Exposures:
    """Measure the pictures of one or more placements of a ring."""
    images, placements = [*chain(*placed)], [(0, k) for k, some in enumerate(placed) for _ in some]
    return exposure.measure(images, views(len(images)), placements, Optics.from_scene(SCENE), SCENE)


def test_each_picture_s_exposure_is_found() -> None:
    found = measured(pictures())
    assert found.measured
    np.testing.assert_allclose(found.gain / found.gain[0], GAINS / GAINS[0], rtol=0.002)
    assert found.wander == pytest.approx(np.std(GAINS), rel=0.05)
    assert not found.clipped.any()
    assert found.bands == 0.0
    assert found.uneven.max() < 0.002
    assert all(np.ndim(found.light(k, (400, 300))) == 0 for k in range(len(GAINS)))


def test_placements_of_a_ring_have_their_exposures_in_common() -> None:
    images = pictures()
    found = measured(images, spoilt(images, [0.9] * 5))
    np.testing.assert_allclose(found.gain[5:] / found.gain[:5], 0.9, rtol=0.003)
    assert found.wander > measured(images).wander


def test_a_black_picture_is_dark_in_a_bright_placement_too() -> None:
    black, *images = pictures()
    found = measured([np.zeros_like(black), *images], spoilt([black, *images], [0.5] * 5))
    np.testing.assert_array_equal(np.flatnonzero(found.dark), [0])


def test_a_clipped_panel_is_told_and_a_narrow_one_tells_nothing() -> None:
    assert measured(pictures(level=1.0)).clipped.max() > 0.1
    narrow = measured(pictures(width=0.6))
    assert not narrow.level.max() > 0.05
    np.testing.assert_array_equal(narrow.gain.round(1), 1.0)


def spoilt(images: list[np.ndarray], share: list[np.ndarray] | list[float]) -> list[np.ndarray]:
    return [np.rint(image * one).clip(0, 65535).astype(np.uint16) for image, one in zip(images, share, strict=True)]


def test_bands_and_slopes_are_found_row_by_row() -> None:
    y, x = np.mgrid[0:300, 0:400]
    phase, slope = np.arange(5)[:, None, None], np.array([0, 1, -1, 1, 0])[:, None, None]
    share = 1.0 + 0.1 * np.sin(2.0 * np.pi * y / 150.0 + phase) + 0.05 * slope * (x - 199.5) / 200.0
    found = measured(spoilt(pictures(), list(share)))
    exposed = GAINS[:, None, None] * share
    light = np.array([found.light(k, (400, 300)) for k in range(5)])
    off = (light * np.median(exposed, axis=0) / exposed - 1.0)[:, 100:290, 60:340]
    assert np.abs(off).max() < 0.06  # the median of five has kinks
    assert np.sqrt(np.mean(off**2, axis=(1, 2))).max() < 0.02
    assert found.bands == pytest.approx(0.07, abs=0.03)
    assert found.uneven.max() < 0.02


def test_what_no_row_shows_is_told_as_uneven() -> None:
    """A blot in two corners of one picture, that is gone half-way to the canister."""
    x = np.mgrid[0:300, 0:400][1]
    blot = 1.0 - 0.5 * np.exp(-(((np.abs(x - 199.5) - 199.5) / 15.0) ** 2))
    found = measured(spoilt(pictures(), [1.0, blot, 1.0, 1.0, 1.0]))
    assert found.uneven[1] > 0.04
    assert found.uneven[[0, 2, 3, 4]].max() < 0.01


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
