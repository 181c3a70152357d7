"""Roots tell the index of the water and how they sway: how pictures move with the rig, and whether what is wrong is found again."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from rhizotwin.recon.calibration.cameras import Cameras, RigUncertainty
from rhizotwin.recon.coverage.evidence import Evidence
from rhizotwin.recon.optics import cameras, projection
from rhizotwin.recon.optics.cameras import View
from rhizotwin.recon.optics.refraction import Optics
from rhizotwin.recon.tubes import rig_derivatives, root_calibration, root_sway, tube_fit, tubes
from rhizotwin.recon.tubes.rig_derivatives import QUANTITIES, SWAY, Quantity
from rhizotwin.recon.tubes.view_correction import Viewed
from rhizotwin.scenes.model import Camera, CapturePlan, Ring, Scene
from tests.recon.hull.exact_pictures import cameras_of, views_of
from tests.recon.strings import blank, drawn

VIEWS = 12
PX_A_MM = 1.9
"""Of the rig's small pictures, about."""
POINTS = np.array([[0.0, 0.0, -50.0], [20.0, 10.0, -30.0], [-35.0, 5.0, -90.0], [10.0, -45.0, -70.0]])


@cache
def rig() -> tuple[list[View], Optics]:
    lens = replace(Camera().resized((400, 300)), distortion=(-0.05, 0.02, 3e-4, -2e-4, 0.0))
    rings = Ring(views=6), Ring(views=6, height_mm=10.0, tilt_deg=8.0, first_deg=10.0)
    scene = Scene(camera=lens, plan=CapturePlan(rings=rings))
    return views_of(scene), Optics.from_scene(scene)


@cache
def system() -> tubes.Tubes:
    """Return a few roots that hang and lean, out to 40 mm from the axis."""
    rng, out = np.random.default_rng(3), np.linspace(2.0, 38.0, 90)
    paths = []
    for turn in np.linspace(0.0, 2.0 * np.pi, 7)[:-1]:
        bend = turn + 0.3 * np.sin(out / 9.0)
        paths.append(np.stack([out * np.cos(bend), out * np.sin(bend), -25.0 - 40.0 * np.sqrt(out / 38.0) * rng.uniform(0.7, 1.2)], axis=1))
    trunk = np.linspace([0.0, 0.0, -20.0], [1.0, 1.0, -75.0], 90)
    return tubes.place_nodes([trunk, *paths], [np.full(90, 0.3)] * 7)


def evidence(views: list[View], optics: Optics) -> Evidence:
    """Return the coverage that the roots cast through these optics, taken for that of the rig."""
    return replace(drawn(system(), blank(views, optics)), bank=projection.ViewBank.pack(*rig()))


def given() -> Cameras:
    """Return cameras with uncertainty as two rings of good markers leave it."""
    camera = [6e-5, 6e-5, 3e-5, 1.5e-2, 1.5e-2, 1.5e-2]
    sigma = np.array([1e-4, 5e-6, 5e-6, 1e-3, 1e-3, *camera, *camera])
    return cameras_of(*rig(), RigUncertainty(np.repeat([0, 1], VIEWS // 2), np.diag(sigma**2), np.full(VIEWS, 7e-5)))


def free() -> np.ndarray:
    return np.zeros(len(system().radius_mm), bool)


@pytest.fixture(scope="module")
def seen_points() -> tuple[np.ndarray, np.ndarray]:
    """Return the pixels of the points in a view, and their gradients (N, 2, 3)."""
    views, optics = rig()
    near = [[cameras.project_inner(views[9], optics, POINTS + side * axis) for side in (0.01, -0.01)] for axis in np.eye(3)]
    return cameras.project_inner(views[9], optics, POINTS), np.stack([(ahead - behind) / 0.02 for ahead, behind in near], axis=-1)


@pytest.mark.parametrize("quantity", [*QUANTITIES, *SWAY], ids=lambda quantity: quantity.name)
def test_pictures_move_as_the_exact_projection_says(quantity: Quantity, seen_points: tuple[np.ndarray, np.ndarray]) -> None:
    (views, optics), (px, gradient) = rig(), seen_points
    view, step = views[9], 20.0 * quantity.step
    above, below = (cameras.project_inner(*quantity.increase((view, optics), side * step), POINTS) for side in (1.0, -1.0))
    rows = [rig_derivatives.picture_derivatives(view, optics, (quantity,), px, POINTS, gradient[:, row])[:, 0] for row in range(2)]
    expected = ((above - below) / (2.0 * step)).T
    error = np.abs(np.array(rows) - expected).max(axis=1)
    assert (error <= 2e-4 * np.abs(expected).max(axis=1) + 1e-3).all()


def test_a_wrong_index_is_found_from_the_roots() -> None:
    views, optics = rig()
    true = replace(optics, n_water=optics.n_water + 0.002)
    seen = evidence(views, true)
    start = tube_fit.fit(seen, system(), free(), steps=4).tubes
    cameras = root_calibration.calibrate(Viewed(seen, given(), start, free())).cameras
    found = cameras.roots
    assert found.believed
    assert found.n_water == pytest.approx(true.n_water, abs=min(4.0 * found.n_water_sigma, 3e-4))
    assert found.after_px < found.before_px
    assert cameras.optics.n_water == found.n_water


def test_a_right_index_and_still_roots_stay_as_they_were_given() -> None:
    seen, start = evidence(*rig()), given()
    given_views = Viewed(seen, start, system(), free())
    calibrated = root_calibration.calibrate(given_views)
    cameras = calibrated.cameras
    assert not cameras.roots.believed
    assert abs(cameras.roots.n_water - rig()[1].n_water) < 3.0 * cameras.roots.n_water_sigma
    assert replace(cameras, roots=None) == start
    assert (calibrated.evidence is seen, calibrated.tubes is system()) == (True, True)
    assert root_sway.follow(given_views, px_a_mm=PX_A_MM) is given_views


def test_swaying_roots_are_followed() -> None:
    views, optics = rig()
    truth = np.random.default_rng(5).normal(0.0, 0.006, (VIEWS, 3)) * [1.0, 1.0, 0.02]
    true = [replace(view, sway=tuple(sway.tolist())) for view, sway in zip(views, truth, strict=True)]
    seen = evidence(true, optics)
    start = tube_fit.fit(seen, system(), free(), steps=4).tubes
    followed = root_sway.follow(Viewed(seen, given(), start, free()), px_a_mm=PX_A_MM)
    exact = replace(seen, bank=projection.ViewBank.pack(true, optics)).project(system().centre_mm)
    still = seen.project(start.centre_mm)

    def off_px(at: np.ndarray) -> float:
        away = np.where(exact.visible[..., None], at - exact.px, np.nan)
        moves = away - np.nanmean(away, axis=0)  # a sway that all views share is none
        return float(np.sqrt(np.nanmean(np.square(moves))))

    before, after = off_px(still.px), off_px(followed.evidence.project(followed.tubes.centre_mm).px)
    assert before > 0.2
    assert after < 0.5 * before
    assert any(view.sway != (0.0, 0.0, 0.0) for view in followed.cameras.views)
