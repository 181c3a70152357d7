"""Exposures told by the bare panel: pictures of a panel with a dark canister before it, each exposed as was drawn."""

from dataclasses import replace
from itertools import chain

import numpy as np
import pytest

from rhizotwin.recon.calibration import exposure
from rhizotwin.recon.optics.cameras import View
from rhizotwin.recon.optics.refraction import Optics
from rhizotwin.scenes import frames
from rhizotwin.scenes.model import Scene

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
