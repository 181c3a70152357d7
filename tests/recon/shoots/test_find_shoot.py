"""Shoots from pictures that a pinhole draws: a ball and a flat disc above the pot, whose sizes are known."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
import trimesh

from rhizotwin.recon.coverage.silhouettes import Silhouette
from rhizotwin.recon.hull.leaves import Hull
from rhizotwin.recon.optics.cameras import View, cam_pixels, matrix
from rhizotwin.recon.shoots import blades, find_shoot, shoot_hull, shoot_silhouettes
from rhizotwin.scenes import frames
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Camera, Scene
from rhizotwin.scenes.monitor import Monitor
from rhizotwin.scenes.shoots import Shoot as Plant
from rhizotwin.sim.shoot import build_shoot

SCENE = replace(Scene(), camera=Camera().resized((400, 300)))
VIEWS = 16
PANEL, GREEN, FELT = 0.75, 0.06, 0.012


def views() -> list[View]:
    still = frames.level_camera(distance_mm=420.0, height_mm=120.0, tilt_deg=10.0)
    return [View(camera=SCENE.camera, cam_from_canister=still @ frames.rotation_z(2.0 * np.pi * k / VIEWS)) for k in range(VIEWS)]


def drawn(view: View, points_mm: np.ndarray) -> np.ndarray:
    """Draw the convex hull of points before panel and pot, 4 x 4 samples a pixel."""
    top = circle(SCENE.net_pot.outer_radius_mm, SCENE.net_pot.top_mm)
    picture = np.full((1200, 1600), PANEL, np.float32)
    turn, shift = view.cam_from_canister[:3, :3], view.cam_from_canister[:3, 3]
    for points, light in ((np.concatenate([top, top - [0.0, 0.0, 180.0]]), 0.3), (top, FELT), (points_mm, GREEN)):
        px = (cv2.projectPoints(points, turn, shift, matrix(view.camera), None)[0] + 0.5) * 4 - 0.5
        cv2.fillPoly(picture, [np.round(cv2.convexHull(px.astype(np.float32))).astype(np.int32)], light)
    return cv2.resize(picture, SCENE.camera.image_wh, interpolation=cv2.INTER_AREA)


def circle(radius_mm: float, z_mm: float) -> np.ndarray:
    angle = np.linspace(0.0, 2.0 * np.pi, 180, endpoint=False)
    return np.stack([radius_mm * np.cos(angle), radius_mm * np.sin(angle), np.full(180, z_mm)], axis=1)


def ball(radius_mm: float, at_mm: tuple[float, float, float]) -> np.ndarray:
    direction = np.random.default_rng(0).normal(size=(20_000, 3))
    return radius_mm * direction / np.linalg.norm(direction, axis=1, keepdims=True) + np.array(at_mm)


def found(points_mm: np.ndarray) -> tuple[float, np.ndarray, float, float]:
    """Return hull volume, bounds of its mesh, half of its surface, and the share of it that leaves would enclose."""
    hull, mesh = carved(silhouettes_of(points_mm), views(), finest_mm=0.5)
    enclosed = shoot_hull.enclosed_share(hull, blades.find_blades(mesh))
    return hull.leaves.volume_mm3(), np.asarray(mesh.bounds), 0.5 * float(mesh.area), enclosed


def silhouettes_of(points_mm: np.ndarray, every: int = 1) -> list[Silhouette]:
    some = views()[::every]
    return shoot_silhouettes.ring_silhouettes([drawn(view, points_mm) for view in some], some, SCENE)


def carved(silhouettes: list[Silhouette], some: list[View], *, finest_mm: float) -> tuple[Hull, trimesh.Trimesh]:
    return shoot_hull.carve_shoot(silhouettes, some, SCENE, finest_mm=finest_mm, monitor=Monitor.of(None))


def whole(coverage: np.ndarray) -> Silhouette:
    return Silhouette(coverage, np.ones(coverage.shape, bool))


@pytest.mark.parametrize("tilt_deg", [0.0, 45.0])
def test_a_pixel_has_the_area_of_a_square_across_the_axis(tilt_deg: float) -> None:
    pose = frames.level_camera(distance_mm=420.0, height_mm=120.0, tilt_deg=tilt_deg)
    view = View(camera=SCENE.camera, cam_from_canister=pose)
    middle = np.array([0.0, 0.0, 120.0 - 420.0 * np.tan(np.deg2rad(tilt_deg))])  # where the optical axis meets that of the canister
    right, down = pose[0, :3], pose[1, :3]
    square = middle + np.array([a * right + b * down for a, b in ((-5.0, -5.0), (5.0, -5.0), (5.0, 5.0), (-5.0, 5.0))])
    px = cam_pixels(view.camera, frames.apply(pose, square))
    assert find_shoot._mm2_per_px(view, SCENE.net_pot.top_mm) == pytest.approx(100.0 / cv2.contourArea(px.astype(np.float32)), rel=1e-5)


def test_a_camera_straight_above_does_not_cut_a_wide_shoot() -> None:
    down = np.array([[0.0, 1.0, 0.0, 0.0], [1.0, 0.0, 0.0, -20.0], [0.0, 0.0, -1.0, 450.0], [0.0, 0.0, 0.0, 1.0]])
    every, plate = (
        [*views(), View(camera=SCENE.camera, cam_from_canister=down)],
        ball(1.0, (0.0, 0.0, 0.0)) * [100.0, 100.0, 4.0] + [0.0, 0.0, 80.0],
    )
    silhouettes = []
    for view in every:
        covered, px = np.zeros((300, 400), np.uint8), cam_pixels(view.camera, frames.apply(view.cam_from_canister, plate))
        cv2.fillPoly(covered, [np.round(cv2.convexHull(px.astype(np.float32))).astype(np.int32)], 1)
        silhouettes.append(whole(covered.astype(np.float32)))
    _, mesh = carved(silhouettes, every, finest_mm=2.0)
    assert np.asarray(mesh.bounds)[:, :2] == pytest.approx(np.array([[-100.0, -100.0], [100.0, 100.0]]), abs=1.5)


def test_a_ball_in_the_air_has_its_size_and_place() -> None:
    volume_mm3, bounds, _, enclosed = found(ball(15.0, (10.0, -5.0, 75.0)))
    assert volume_mm3 == pytest.approx(4.0 / 3.0 * np.pi * 15.0**3, rel=0.04)
    assert bounds == pytest.approx(np.array([[-5.0, -20.0, 60.0], [25.0, 10.0, 90.0]]), abs=0.7)
    assert enclosed == pytest.approx((13.0 / 15.0) ** 3, abs=0.05), "what is deeper than 2 mm"


def test_a_disc_that_leans_has_its_one_sided_area() -> None:
    disc = np.concatenate([circle(20.0, 0.5), circle(20.0, -0.5)])  # 1 mm thick: 1.5 px
    lean = frames.from_rotvec(np.array([np.deg2rad(40.0), 0.0, 0.0]), np.array([0.0, 0.0, 80.0]))
    *_, half_mm2, enclosed = found(frames.apply(lean, disc))
    assert half_mm2 == pytest.approx(np.pi * (400.0 + 20.0), rel=0.06)
    assert enclosed < find_shoot.MUCH_ENCLOSED


def test_a_canister_beyond_the_lens_is_masked_down_to_the_edge() -> None:
    """The front of the foot is beyond the fold of the lens, which is at the corners of the picture."""
    lens = Camera(focal_px=(800.0, 800.0), distortion=(-0.37, 0.0, 0.0, 0.0, 0.0))
    view = View(camera=lens, cam_from_canister=frames.level_camera(distance_mm=200.0, height_mm=60.0, tilt_deg=0.0))
    masked = np.any(shoot_silhouettes._pot_masks(view, SCENE, (600, 800))[:2], axis=0)
    assert masked[400:, 400].all()
    assert not masked[:250].any()


def test_empty_silhouettes_are_no_shoot() -> None:
    with pytest.raises(UserError, match="no volume in common"):
        carved([whole(np.zeros((300, 400), np.float32))] * 4, views()[::4], finest_mm=2.0)


def test_what_stands_before_the_pot_does_not_carve() -> None:
    found = silhouettes_of(ball(12.0, (0.0, 0.0, 50.0)), every=2)[0]
    covered = found.coverage > 0.5
    assert covered.sum() > 300
    assert found.usable[covered].mean() < 0.7
    assert not found.usable[250, 200]


def blade(at_mm: tuple[float, float, float], *, width_mm: float = 16.0) -> trimesh.Trimesh:
    return trimesh.creation.box((30.0, width_mm, 0.5)).apply_translation(at_mm)


def test_blades_that_touch_are_one_and_a_stalk_is_none() -> None:
    stalk = trimesh.creation.cylinder(radius=1.2, height=40.0, sections=32)
    found = blades.find_blades(trimesh.util.concatenate([stalk, blade((15.0, 0.0, 24.0)), blade((-15.0, 0.0, -24.0), width_mm=10.0)]))
    assert found.areas_mm2 == pytest.approx((30.0 * 16.5, 30.0 * 10.5), rel=0.05)  # and half of their sides
    assert found.near(np.array([[0.0, 0.0, 0.0], [20.0, 0.0, 24.0]])).tolist() == [False, True]
    assert len(blades.find_blades(trimesh.util.concatenate([blade((0.0, 0.0, 0.0)), blade((29.0, 0.0, 0.3))])).areas_mm2) == 1
    alone = blades.find_blades(stalk)
    assert alone.areas_mm2 == ()
    assert alone.area_mm2 < 0.1 * 0.5 * stalk.area


def test_a_grown_shoot_has_its_leaves_and_their_area() -> None:
    solid = build_shoot(replace(Scene(), shoot=Plant(seed=3, leaves=6)))
    assert solid is not None
    found = blades.find_blades(trimesh.Trimesh(solid.vertices, solid.faces, process=False))
    assert len(found.areas_mm2) == 6
    assert found.area_mm2 == pytest.approx(solid.leaf_area_mm2, rel=0.07)
