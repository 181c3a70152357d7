"""Cameras without markers, from pictures that a few lines of NumPy draw: a canister's edges and opaque threads, parallel straight rays."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from rhizotwin.recon.calibration.bare_canister import find_cameras
from rhizotwin.scenes import frames
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Camera, Canister, CapturePlan, Ring, Scene, Surroundings, Water

WIDTH, HEIGHT, MM_PER_PX = 300, 220, 0.4
SCENE = Scene(
    canister=Canister(outer_radius_mm=45.0, wall_mm=4.0, height_mm=84.0, base_mm=4.0),
    water=Water(level_mm=-4.0),
    surroundings=Surroundings(n=1.333),
    camera=Camera(kind="telecentric", mm_per_px=1.0, image_wh=(WIDTH, HEIGHT), principal_px=((WIDTH - 1) / 2, (HEIGHT - 1) / 2)),
    plan=CapturePlan(rings=(Ring(views=30, distance_mm=300.0),)),
)
TABLE_DEG = [12.0 * k for k in range(30)]


@cache
def threads() -> np.ndarray:
    """Return points (N, 3) along five opaque threads, mm."""
    rng = np.random.default_rng(3)
    lines = []
    for _ in range(5):
        start, end = rng.uniform([-8, -8, -14], [8, 8, -10]), rng.uniform([-30, -30, -76], [30, 30, -40])
        t = np.linspace(0.0, 1.0, 900)[:, None]
        lines.append(start + t * (end - start) + np.sin(9.0 * t) * rng.uniform(-3, 3, 3))
    return np.concatenate(lines)


def cam_from_canister(azimuth: float, elevation: float, offset_px: float) -> np.ndarray:
    """Return the camera's pose: at an azimuth and above the horizon, the axis some pixels beside the picture's middle."""
    right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    forward = -np.cos(elevation) * np.array([np.cos(azimuth), np.sin(azimuth), 0.0]) - np.sin(elevation) * np.array([0.0, 0.0, 1.0])
    turn = np.stack([right, np.cross(forward, right), forward])
    middle = np.array([offset_px * MM_PER_PX, 0.0, 300.0])
    return frames.from_rotation_translation(turn, middle - turn @ np.array([0.0, 0.0, -42.0]))


def draw(pose: np.ndarray, points_mm: np.ndarray) -> np.ndarray:
    """Draw a picture (H, W): bright panel, dark canister walls, water between surface and floor, threads 1.5 px wide."""
    middle = np.array(SCENE.camera.principal_px)
    (x, top), (x_floor, floor) = frames.apply(pose, np.array([[0.0, 0.0, -4.0], [0.0, 0.0, -80.0]]))[:, :2] / MM_PER_PX + middle
    column, row = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    away = np.abs(column - (x + (x_floor - x) * (row - top) / (floor - top)))
    within = [np.clip(radius / MM_PER_PX - away + 0.5, 0.0, 1.0) for radius in (45.0, 41.0)]
    light = 1.0 - within[0] + within[1] * np.clip(row - top + 0.5, 0.0, 1.0) * np.clip(floor - row + 0.5, 0.0, 1.0)
    px = frames.apply(pose, points_mm)[:, :2] / MM_PER_PX + middle
    clear = np.ones((HEIGHT, WIDTH))
    for shift in np.ndindex(5, 5):
        near = np.floor(px).astype(int) + np.array(shift) - 2
        distance = np.hypot(*(near - px).T)
        inside = (near >= 0).all(axis=1) & (near < [WIDTH, HEIGHT]).all(axis=1)
        np.minimum.at(clear, (near[inside, 1], near[inside, 0]), np.clip(distance[inside] - 0.25, 0.0, 1.0))
    return np.round(230.0 * light * clear).astype(np.uint8)


def poses(azimuths: np.ndarray, elevation: float = 0.0) -> list[np.ndarray]:
    rng = np.random.default_rng(0)
    return [cam_from_canister(float(azimuth), elevation, 3.0 + float(rng.normal(0.0, 0.5))) for azimuth in azimuths]


EVEN = poses(-np.deg2rad(np.array(TABLE_DEG)))


@cache
def even_pictures() -> list[np.ndarray]:
    return [draw(pose, threads()) for pose in EVEN]


def test_uneven_steps_scale_and_elevation_are_found():
    uneven = np.random.default_rng(1).normal(0.0, 0.8, 30)
    uneven[0] = 0.0
    azimuth = np.deg2rad(0.99 * np.array(TABLE_DEG) + uneven)
    scene = replace(SCENE, turntable=replace(SCENE.turntable, direction=-1))
    found = find_cameras([draw(pose, threads()) for pose in poses(azimuth, np.deg2rad(0.5))], scene, TABLE_DEG)
    assert found.mm_per_px == pytest.approx(MM_PER_PX, rel=0.003)
    assert abs(found.mm_per_px / MM_PER_PX - 1.0) < 3.0 * found.uncertainty.scale < 0.01
    off = found.azimuth_deg - np.rad2deg(azimuth)
    assert np.std(off) < 0.25
    assert 0.3 * np.std(off) < np.rad2deg(found.uncertainty.azimuth_rad) < 3.0 * np.std(off)
    assert np.abs(off).max() < 0.6
    assert found.elevation_deg == pytest.approx(0.5, abs=0.2)
    assert found.floor_z_mm == pytest.approx(-80.0, abs=0.5)


def test_the_poses_put_points_where_the_pictures_have_them():
    found = find_cameras(even_pictures(), SCENE, TABLE_DEG)
    at, true = (np.array([frames.apply(pose, threads()[::100])[:, :2] for pose in every]) for every in (found.cam_from_canister, EVEN))
    errors = at / found.mm_per_px - true / MM_PER_PX
    # rows may be off together, by what the water's surface is blurred; z = 0 hangs on it
    errors -= [0.0, np.median(errors[..., 1])]
    assert np.sqrt(np.mean(errors**2)) < 0.25


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda drawn: (drawn[:5], SCENE, TABLE_DEG[:5]), "too few"),
        (lambda drawn: ([drawn[0]] * 30, SCENE, TABLE_DEG), "slips or does not move"),
        (lambda drawn: ([picture[60:] for picture in drawn], SCENE, TABLE_DEG), "surface"),
        (lambda drawn: (drawn, replace(SCENE, camera=Camera()), TABLE_DEG), "telecentric"),
    ],
    ids=["five views", "a table that stands still", "no surface", "pinhole"],
)
def test_what_cannot_be_found_is_said(change, sentence):
    with pytest.raises(UserError, match=sentence):
        find_cameras(*change(even_pictures()))
