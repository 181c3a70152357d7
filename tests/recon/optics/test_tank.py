"""Lines of sight through a tank against brute-force ray tracing: vector Snell at each surface, which shares nothing with `recon`."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from rhizotwin.recon.optics import tank
from rhizotwin.recon.optics.cameras import View, camera_directions
from rhizotwin.scenes import frames
from rhizotwin.scenes.model import Camera, Canister, Scene, Tank

Array = NDArray[np.float64]
SCENE = Scene(tank=Tank())
LENS = Camera(distortion=(-0.05, 0.02, 0.001, -0.002, 0.001))


def seen_from(rng: np.random.Generator, scene: Scene = SCENE) -> tank.TankView:
    """Return a camera at a random height, tilt and side, and a canister that is turned, leans and stands aside."""
    tilt = rng.uniform(-8.0, 15.0)
    level = frames.level_camera(distance_mm=rng.uniform(350, 450), height_mm=-60.0 + 6.5 * tilt, tilt_deg=tilt)
    cam_from_rig = frames.from_rotvec(rng.normal(0.0, 0.02, 3), rng.normal(0.0, 5.0, 3)) @ level
    seat = frames.from_rotvec(rng.normal(0.0, 0.01, 3) * [1, 1, 0], rng.normal(0.0, 1.0, 3) * [1, 1, 0])
    canister_from_rig = frames.invert(frames.rotation_z(rng.uniform(-np.pi, np.pi)) @ seat)
    view = View(camera=LENS, cam_from_canister=cam_from_rig @ frames.invert(canister_from_rig))
    return tank.TankView.of(scene, view, canister_from_rig)


def snell(direction: Array, normal: Array, n_from: float, n_to: float) -> Array:
    """Refract unit directions (N, 3) at unit normals that face the incoming rays."""
    ratio = n_from / n_to
    cosine = -np.sum(direction * normal, axis=1, keepdims=True)
    return np.asarray(ratio * direction + (ratio * cosine - np.sqrt(1.0 - ratio**2 * (1.0 - cosine**2))) * normal)


def brute(at: tank.TankView, px: Array) -> tuple[Array, Array]:
    """Follow pixels surface by surface: where each enters the water (N, 3) and its unit direction there, canister frame."""
    rig_from_cam = np.linalg.inv(at.view.cam_from_canister @ at.canister_from_rig)
    d = camera_directions(at.view.camera, px) @ rig_from_cam[:3, :3].T
    p = np.broadcast_to(rig_from_cam[:3, 3], d.shape)
    box, can, o = at.tank, at.optics, at.optics
    facing = np.broadcast_to([1.0, 0.0, 0.0], d.shape)
    for x, n_from, n_to in ((box.front_mm, 1.0, box.n_wall), (box.front_mm - box.wall_mm, box.n_wall, box.n_liquid)):
        p = p + ((x - p[:, 0]) / d[:, 0])[:, None] * d
        d = snell(d, facing, n_from, n_to)
    p, d = frames.apply(at.canister_from_rig, p), d @ at.canister_from_rig[:3, :3].T
    for radius, n_from, n_to in ((can.outer_radius_mm, box.n_liquid, o.n_wall), (can.inner_radius_mm, o.n_wall, o.n_water)):
        a, b, c = np.sum(d[:, :2] ** 2, axis=1), np.sum(p[:, :2] * d[:, :2], axis=1), np.sum(p[:, :2] ** 2, axis=1) - radius**2
        with np.errstate(invalid="ignore"):
            p = p + ((-b - np.sqrt(b * b - a * c)) / a)[:, None] * d
            d = snell(d, p * [1, 1, 0] / radius, n_from, n_to)
    return p, d


def points_on_rays(at: tank.TankView, rng: np.random.Generator, count: int, *, most: float = 0.99) -> tuple[Array, Array]:
    """Return pixels that see water, and on each one's brute-force ray a random point of it."""
    width, height = at.view.camera.image_wh
    px = rng.uniform([0, 0], [width, height], (count, 2))
    px = px[tank.water_lines(at, px)[1]]
    entry, d = brute(at, px)
    leave = -2.0 * np.sum(entry[:, :2] * d[:, :2], axis=1) / np.sum(d[:, :2] ** 2, axis=1)
    points = entry + d * (rng.uniform(0.01, 0.99, len(entry)) * leave)[:, None]
    inside = np.hypot(points[:, 0], points[:, 1]) < most * at.optics.inner_radius_mm
    return px[inside], points[inside]


@pytest.mark.parametrize("liquid", [1.333, 1.36, 1.49])
def test_lines_are_those_of_brute_force(liquid: float) -> None:
    rng = np.random.default_rng(1)
    for _ in range(3):
        at = seen_from(rng, replace(SCENE, tank=replace(Tank(), n_liquid=liquid)))
        px = rng.uniform([0, 0], at.view.camera.image_wh, (2000, 2))
        line, enters = tank.water_lines(at, px)
        entry, d = brute(at, px)
        assert enters.sum() > 200
        assert np.abs(entry[enters, 2] - line.entry_z_mm[enters]).max() < 1e-9
        beside = np.sum(entry[:, :2] * line.nu, axis=1) - line.b_mm
        assert np.abs(beside[enters]).max() < 1e-9
        along = d[:, :2] / np.linalg.norm(d[:, :2], axis=1, keepdims=True)
        assert np.abs(along - line.t)[enters].max() < 1e-11
        assert np.abs(d[:, 2] / np.linalg.norm(d[:, :2], axis=1) - line.slope)[enters].max() < 1e-11


def test_points_come_back_to_their_pixels() -> None:
    rng = np.random.default_rng(2)
    for _ in range(4):
        at = seen_from(rng)
        px, points = points_on_rays(at, rng, 3000)
        found, seen, _ = tank.project(at, points)
        radius = np.hypot(points[:, 0], points[:, 1]) / at.optics.inner_radius_mm
        assert seen[radius < 0.95].all()
        assert seen.mean() > 0.99
        assert np.abs(found - px)[seen & (radius < 0.95)].max() < 1e-5


def test_jacobian_is_that_of_differences() -> None:
    rng = np.random.default_rng(3)
    at = seen_from(rng)
    _, points = points_on_rays(at, rng, 600, most=0.9)
    _, seen, jacobian = tank.project(at, points)
    step = 1e-3
    for axis in range(3):
        shift = step * np.eye(3)[axis]
        up, down = tank.project(at, points + shift), tank.project(at, points - shift)
        both = seen & up[1] & down[1]
        slope = (up[0] - down[0]) / (2.0 * step)
        assert both.sum() > 100
        assert np.abs(slope - jacobian[:, :, axis])[both].max() < 1e-4


def test_without_any_bending_it_is_the_plain_camera() -> None:
    air = replace(
        SCENE,
        tank=Tank(n_wall=1.0, n_liquid=1.0),
        canister=Canister(n_wall=1.0),
        water=replace(SCENE.water, n_water=1.0),
    )
    at = seen_from(np.random.default_rng(4), air)
    points = np.random.default_rng(5).uniform([-40, -40, -120], [40, 40, -20], (200, 3))
    found, seen, _ = tank.project(at, points)
    in_cam = frames.apply(at.view.cam_from_canister, points)
    directions = camera_directions(at.view.camera, found[seen])
    assert seen.sum() > 100
    assert np.abs(directions - in_cam[seen] / np.linalg.norm(in_cam[seen], axis=1, keepdims=True)).max() < 1e-8


def test_a_view_through_the_tank_sees_what_the_round_canister_hides() -> None:
    """T5.3: through the round wall nothing beyond R_o / n_water is seen from the side; through the tank nearly all is."""
    level = frames.level_camera(distance_mm=400.0, height_mm=-60.0, tilt_deg=0.0)
    at = tank.TankView.of(SCENE, View(camera=Camera(), cam_from_canister=level), np.eye(4))
    inner = at.optics.inner_radius_mm
    beside = np.array([[0.0, y, -60.0] for y in np.linspace(-0.97, 0.97, 41) * inner])
    assert (tank.images_at_height(at, beside) == 1).all()


def test_what_is_above_the_liquid_is_not_seen() -> None:
    level = frames.level_camera(distance_mm=400.0, height_mm=-42.0, tilt_deg=0.0)
    at = tank.TankView.of(SCENE, View(camera=Camera(), cam_from_canister=level), np.eye(4))
    low = replace(at, tank=replace(at.tank, level_mm=-60.0))
    points = np.array([[0.0, 0.0, -20.0], [0.0, 0.0, -100.0]])
    assert tank.project(at, points)[1].tolist() == [True, True]
    assert tank.project(low, points)[1].tolist() == [False, True]
