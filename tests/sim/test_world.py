"""What is drawn: nothing where nothing is wrong, and the same for a view whatever is taken before it."""

from dataclasses import replace

import numpy as np
import pytest

from rhizotwin.scenes import frames, plan
from rhizotwin.scenes.disturbances import Disturbances
from rhizotwin.scenes.files import load_profile
from rhizotwin.scenes.model import Canister, CapturePlan, NetPot, Ring, Scene
from rhizotwin.sim.world import World, draw_world

WRONG = replace(load_profile("harsh"), algae_patches=20, algae_opacity=0.5, felt_fibres=30, bubbles=30, backlight_unevenness=0.3)


def world_of(seed: int, *, rings: tuple[Ring, ...] = (Ring(views=6), Ring(views=4, height_mm=90.0)), wrong: Disturbances = WRONG) -> World:
    return draw_world(Scene(plan=CapturePlan(rings=rings), disturbances=wrong), seed=seed)


def test_a_perfect_rig_is_where_the_plan_says() -> None:
    scene = Scene(plan=CapturePlan(rings=(Ring(views=7, jitter_mm=2.0, jitter_deg=1.0),)))
    world = draw_world(scene, seed=3)
    for view, camera in zip(plan.views(scene, seed=3), world.cameras, strict=True):
        np.testing.assert_allclose(camera.cam_from_canister, view.cam_from_rig @ plan.rig_from_table(scene, view.table_deg), atol=1e-12)
    assert world.n_water == scene.water.n_water
    np.testing.assert_array_equal(world.canister_from_strip, np.eye(4))
    assert world.backlight is None
    assert not world.algae + world.fibres + world.bubbles


def test_the_arm_errs_once_a_ring_and_the_table_in_every_view() -> None:
    world = world_of(2)
    first, second = world.cameras[:6], world.cameras[6:]
    for camera in first:
        np.testing.assert_array_equal(camera.cam_from_rig, first[0].cam_from_rig)
    nominal = (frames.level_camera(distance_mm=400.0, height_mm=z, tilt_deg=0.0) for z in (-42.0, 90.0))
    errors = [camera.cam_from_rig @ frames.invert(n) for camera, n in zip((first[0], second[0]), nominal, strict=True)]
    assert np.abs(errors[0] - errors[1]).max() > 1e-3
    offsets = [camera.table_deg - 60.0 * k for k, camera in enumerate(first)]
    assert len(set(offsets)) == 6


def test_errors_have_the_size_that_the_profile_names() -> None:
    nominal = frames.invert(frames.level_camera(distance_mm=400.0, height_mm=-42.0, tilt_deg=0.0))
    clear = replace(WRONG, algae_patches=0, felt_fibres=0, bubbles=0)
    worlds = [world_of(seed, rings=(Ring(views=1),), wrong=clear) for seed in range(150)]
    arms = np.array([frames.to_rotvec(world.cameras[0].cam_from_rig @ nominal) for world in worlds])
    assert np.rad2deg(arms).std() == pytest.approx(0.3, rel=0.12)
    seat = world_of(9).table_from_canister
    assert np.linalg.norm(seat[:3, 3]) == pytest.approx(1.0)
    assert np.rad2deg(np.linalg.norm(frames.to_rotvec(seat))) == pytest.approx(0.5)
    assert np.ptp(world_of(9).backlight) == pytest.approx(0.3)


def test_dirt_stays_in_the_water() -> None:
    world, can = world_of(4), Canister()
    x, y, z, radius = np.array([(bubble.x_mm, bubble.y_mm, bubble.z_mm, bubble.radius_mm) for bubble in world.bubbles]).T
    assert (np.hypot(x, y) + radius).max() < can.inner_radius_mm
    assert can.floor_z_mm < (z - radius).min() < (z + radius).max() < NetPot().grid_z_mm
    assert np.hypot(*np.concatenate([fibre.points_mm for fibre in world.fibres])[:, :2].T).max() < can.inner_radius_mm
    assert {fibre.points_mm[:, 2].max() for fibre in world.fibres} == {NetPot().grid_z_mm}
