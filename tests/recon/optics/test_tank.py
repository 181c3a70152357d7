"""Lines of sight through a tank against brute-force ray tracing: vector Snell at each surface, which shares nothing with `recon`."""

from dataclasses import replace

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from numpy.typing import NDArray

from benchmarks.projection import meet, snell
from rhizotwin.recon.optics import cameras, projection
from rhizotwin.recon.optics.cameras import View, camera_directions
from rhizotwin.recon.optics.refraction import Optics, WaterLine
from rhizotwin.scenes import frames
from rhizotwin.scenes.model import Camera, Scene, Tank

Array = NDArray[np.float64]
SCENE = Scene(tank=Tank())
LENS = Camera(distortion=(-0.05, 0.02, 0.001, -0.002, 0.001))

Seen = tuple[View, Optics]


def seen_from(rng: np.random.Generator, scene: Scene = SCENE) -> Seen:
    """Return a camera at a random height, tilt and side, and a canister that is turned, leans and stands aside."""
    tilt = rng.uniform(-8.0, 15.0)
    level = frames.level_camera(distance_mm=rng.uniform(350, 450), height_mm=-60.0 + 6.5 * tilt, tilt_deg=tilt)
    cam_from_rig = frames.from_rotvec(rng.normal(0.0, 0.02, 3), rng.normal(0.0, 5.0, 3)) @ level
    seat = frames.from_rotvec(rng.normal(0.0, 0.01, 3) * [1, 1, 0], rng.normal(0.0, 1.0, 3) * [1, 1, 0])
    canister_from_rig = frames.invert(frames.rotation_z(rng.uniform(-np.pi, np.pi)) @ seat)
    view = View(camera=LENS, cam_from_canister=cam_from_rig @ frames.invert(canister_from_rig), cam_from_tank=cam_from_rig)
    return view, Optics.from_scene(scene)


def lines_in_canister(at: Seen, px: Array) -> tuple[WaterLine, Array]:
    """Return the lines of sight of pixels in the canister's frame, and which enter the water."""
    line, enters = cameras.water_lines(*at, px)
    return replace(line, heading_rad=line.heading_rad + np.arctan2(at[0].centre_mm[1], at[0].centre_mm[0])), enters


def brute(at: Seen, px: Array) -> tuple[Array, Array]:
    """Follow pixels surface by surface: where each enters the water (N, 3) and its unit direction there, canister frame."""
    view, o = at
    rig_from_cam, box = np.linalg.inv(np.asarray(view.cam_from_tank)), o.tank
    canister_from_rig = np.linalg.inv(view.cam_from_canister) @ view.cam_from_tank
    d = camera_directions(view.camera, px) @ rig_from_cam[:3, :3].T
    p = np.broadcast_to(rig_from_cam[:3, 3], d.shape)
    for x, ratio in ((box.front_mm, 1.0 / box.n_wall), (box.front_mm - box.wall_mm, box.n_wall / box.n_liquid)):
        p = p + ((x - p[:, 0]) / d[:, 0])[:, None] * d
        d = snell(d, np.broadcast_to([1.0, 0.0, 0.0], d.shape), ratio)
    p, d = frames.apply(canister_from_rig, p), d @ canister_from_rig[:3, :3].T
    for radius, ratio in ((o.outer_radius_mm, box.n_liquid / o.n_wall), (o.inner_radius_mm, o.n_wall / o.n_water)):
        p = meet(p, d, radius)
        with np.errstate(invalid="ignore"):
            d = snell(d, p * [1, 1, 0] / radius, ratio)
    return p, d


def points_on_rays(at: Seen, rng: np.random.Generator, count: int, *, most: float) -> tuple[Array, Array]:
    """Return pixels that see water, and on each one's brute-force ray a random point of it."""
    px = rng.uniform([0, 0], at[0].camera.image_wh, (count, 2))
    px = px[lines_in_canister(at, px)[1]]
    entry, d = brute(at, px)
    leave = -2.0 * np.sum(entry[:, :2] * d[:, :2], axis=1) / np.sum(d[:, :2] ** 2, axis=1)
    points = entry + d * (rng.uniform(0.01, 0.99, len(entry)) * leave)[:, None]
    inside = np.hypot(points[:, 0], points[:, 1]) < most * at[1].inner_radius_mm
    return px[inside], points[inside]


@pytest.mark.parametrize(("seed", "liquid"), [(1, 1.333), (3, 1.49)])
def test_lines_are_those_of_brute_force(seed: int, liquid: float) -> None:
    rng = np.random.default_rng(seed)
    at = seen_from(rng, replace(SCENE, tank=replace(Tank(), n_liquid=liquid)))
    px = rng.uniform([0, 0], at[0].camera.image_wh, (2000, 2))
    line, enters = lines_in_canister(at, px)
    entry, d = brute(at, px)
    level = np.linalg.norm(d[:, :2], axis=1, keepdims=True)
    assert enters.sum() > 200
    assert np.abs(entry[:, 2] - line.entry_z_mm)[enters].max() < 1e-9
    assert np.abs(np.sum(entry[:, :2] * line.nu, axis=1) - line.b_mm)[enters].max() < 1e-9
    assert np.abs(d[:, :2] / level - line.t)[enters].max() < 1e-11
    assert np.abs(d[:, 2] / level[:, 0] - line.slope)[enters].max() < 1e-11


def test_points_come_back_to_pixels() -> None:
    rng = np.random.default_rng(0)
    at = seen_from(rng)
    px, points = points_on_rays(at, rng, 1500, most=0.99)
    found = cameras.project_inner(*at, points)
    seen, inner = np.isfinite(found).all(axis=1), np.hypot(points[:, 0], points[:, 1]) / at[1].inner_radius_mm < 0.9
    assert seen[inner].all()
    assert seen.mean() > 0.99
    assert np.abs(found - px)[inner].max() < 1e-5


def in_kernel(at: Seen, points: Array) -> projection.Projected:
    """Project points in the fast kernel, as the second of two views."""
    other, _ = seen_from(np.random.default_rng(9))
    bank = projection.ViewBank.pack([other, at[0]], at[1])
    view = dr.full(mi.UInt32, 1, len(points))
    found = projection.project(bank, view, mi.Point3f(points.T.astype(np.float32)), dr.full(mi.Bool, True, len(points)))
    dr.eval(found.px, found.visible, found.du, found.dv)  # in one kernel
    return found


@pytest.mark.parametrize("liquid", [1.3, 1.38])
def test_the_kernel_agrees_with_the_reference(liquid: float) -> None:
    rng = np.random.default_rng(7)
    at = seen_from(rng, replace(SCENE, tank=replace(Tank(), n_liquid=liquid)))
    angle, radius = rng.uniform(-np.pi, np.pi, 6000), 73.0 * np.sqrt(rng.uniform(0.0, 1.0, 6000))
    points = np.stack([radius * np.cos(angle), radius * np.sin(angle), rng.uniform(-149.0, -8.0, 6000)], axis=1)
    points = points.astype(np.float32).astype(np.float64)
    expected = cameras.project_inner(*at, points)
    seen, found = np.isfinite(expected).all(axis=1), in_kernel(at, points)
    kernel, inner = np.array(found.visible), np.hypot(points[:, 0], points[:, 1]) / at[1].inner_radius_mm < 0.95
    both = kernel & seen
    assert not (kernel & ~seen).any()
    assert (seen & ~kernel).mean() < 0.02, "only what is next to the wall beside the line of sight is given away"
    assert not (seen & ~kernel)[inner].any()
    off = np.abs(np.array(found.px).T - expected)
    assert off[both & inner].max() < 1e-3
    assert off[both].max() < 5e-3  # next to total reflection single precision moves a ray by more
    slope = np.stack([np.array(found.du).T, np.array(found.dv).T], axis=1)
    for axis, shift in enumerate(1e-3 * np.eye(3)):
        up, down = (cameras.project_inner(*at, points + side * shift) for side in (1.0, -1.0))
        assert np.abs((up - down) / 2e-3 - slope[:, :, axis])[both & inner].max() < 2e-3


def test_the_canister_is_seen_up_to_the_liquid_s_surface() -> None:
    level = frames.level_camera(distance_mm=400.0, height_mm=-60.0, tilt_deg=0.0)
    view, points = View(camera=Camera(), cam_from_canister=level, cam_from_tank=level), np.array([[0.0, 0.0, -20.0], [0.0, 0.0, -100.0]])
    filled = [replace(Optics.from_scene(SCENE), tank=Tank(level_mm=level_mm)) for level_mm in (Tank().level_mm, -60.0)]
    assert [np.isfinite(cameras.project_inner(view, optics, points)[:, 0]).tolist() for optics in filled] == [[True, True], [False, True]]
