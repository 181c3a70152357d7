"""Exposures told by the bare panel: pictures of a panel with a dark canister before it, each exposed as was drawn."""

from dataclasses import replace

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
    return [
        View(camera=SCENE.camera, cam_from_canister=cam_from_rig @ frames.from_rotvec(np.array([0.0, 0.0, k]), np.zeros(3)))
        for k in range(count)
    ]


def pictures(level: float = 0.6, width: float = 1.0) -> list[np.ndarray]:
    """Draw an uneven panel, with a canister before it that is another in each picture; the panel covers ``width`` of the picture."""
    rng = np.random.default_rng(3)
    x = np.linspace(-1.0, 1.0, 400)[None, :]
    panel = level * (1.0 - 0.2 * x**2) * np.ones((300, 1))
    panel = np.where(np.abs(x) < width, panel, 0.004)
    found = []
    for gain in GAINS:
        light = np.where(np.abs(x) < 0.63, rng.uniform(0.0, 1.0, (300, 400)) * panel, panel) * gain
        found.append(np.rint(65535.0 * np.clip(light + rng.normal(0.0, 0.004, light.shape), 0.0, 1.0)).astype(np.uint16))
    return found


def measured(images: list[np.ndarray]) -> exposure.Exposures:
    return exposure.measure(images, views(len(images)), [(0, 0)] * len(images), Optics.of(SCENE), SCENE)


def test_each_picture_s_exposure_is_found() -> None:
    found = measured(pictures())
    assert found.told
    np.testing.assert_allclose(found.gain / found.gain[0], GAINS / GAINS[0], rtol=0.002)
    assert found.wander == pytest.approx(np.std(GAINS), rel=0.05)
    assert not found.clipped.any()


def test_a_clipped_panel_is_told() -> None:
    found = measured(pictures(level=1.0))
    assert found.clipped.max() > 0.1


def test_a_panel_no_wider_than_the_canister_tells_nothing() -> None:
    found = measured(pictures(width=0.6))
    assert not found.level.max() > 0.05
    np.testing.assert_array_equal(found.gain.round(1), 1.0)
