"""Rays of pixels: points on them appear in these pixels, whatever the canister, the tank or the motion of the roots."""

import json
import runpy
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from benchmarks.projection import all_images
from rhizotwin.exporter import rays
from rhizotwin.recon.optics.cameras import View, project_inner
from rhizotwin.recon.optics.refraction import Optics
from rhizotwin.scenes import frames
from rhizotwin.scenes.model import Camera, Scene, Tank

SCENE = Scene(camera=Camera().resized((200, 150)))
TANK = replace(SCENE, tank=Tank())
STEEP = frames.level_camera(distance_mm=400.0, height_mm=20.0, tilt_deg=12.0)
LEVEL = frames.level_camera(distance_mm=400.0, height_mm=-60.0, tilt_deg=1.0)


def seen(pose: np.ndarray, *, scene: Scene = SCENE, sway: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> View:
    turned = pose @ frames.rotation_z(np.deg2rad(-40.0))
    return View(camera=scene.camera, cam_from_canister=turned, cam_from_tank=None if scene.tank is None else pose, sway=sway)


@pytest.mark.parametrize(
    ("scene", "view"),
    [
        (SCENE, seen(LEVEL)),
        (SCENE, seen(STEEP)),
        (SCENE, seen(LEVEL, sway=(0.004, -0.003, 2e-5))),
        (TANK, seen(LEVEL, scene=TANK)),
    ],
    ids=["level", "steep", "moving roots", "tank"],
)
def test_points_on_rays_appear_in_their_pixels(scene: Scene, view: View) -> None:
    optics, rng = Optics.from_scene(scene), np.random.default_rng(4)
    traced = rays.trace(view, optics, scene)
    rows, columns = np.nonzero(np.isfinite(traced.length_mm))
    assert len(rows) > 0.2 * traced.length_mm.size
    chosen = rng.permutation(len(rows))[:1000]
    row, column = rows[chosen], columns[chosen]
    along_mm = rng.uniform(0.01, 0.99, len(chosen)) * traced.length_mm[row, column]
    points = traced.origin_mm[row, column].astype(float) + along_mm[:, None] * traced.direction[row, column]
    images = all_images(view, optics, points)[0] if scene.tank is None else project_inner(view, optics, points)[:, None]
    away_px = np.linalg.norm(images - np.stack([column, row], axis=1)[:, None], axis=2)
    known = np.isfinite(away_px).any(axis=1)
    assert known.mean() > (0.99 if scene.tank is None else 0.5)  # through a tank, only points near the axis are projected
    assert np.nanmin(away_px[known], axis=1).max() < 0.05


def test_single_points_appear_once() -> None:
    view, optics, rng = seen(LEVEL), Optics.from_scene(SCENE), np.random.default_rng(2)
    traced = rays.trace(view, optics, SCENE)
    rows, columns = np.nonzero(np.isfinite(traced.length_mm))
    chosen = rng.permutation(len(rows))[:500]
    at = rows[chosen], columns[chosen]
    low, high = traced.single_mm[at].astype(float).T
    inside, outside = low + rng.uniform(0.0, 1.0, len(low)) * (high - low), 0.5 * (high + traced.length_mm[at])
    counts = [all_images(view, optics, traced.origin_mm[at] + far[:, None] * traced.direction[at])[1] for far in (inside, outside)]
    assert (counts[0] == 1).mean() > 0.99
    assert (counts[0] <= 1).all()
    assert (counts[1] > 1).any()


def test_rays_end_where_the_water_does() -> None:
    view, optics = seen(STEEP), Optics.from_scene(SCENE)
    traced = rays.trace(view, optics, SCENE)
    end = (traced.origin_mm + traced.length_mm[..., None] * traced.direction)[np.isfinite(traced.length_mm)]
    radius_mm = np.hypot(end[:, 0], end[:, 1])
    assert radius_mm.max() < optics.inner_radius_mm + 1e-3
    assert end[:, 2].min() > optics.floor_z_mm - 1e-3
    assert (np.isclose(radius_mm, optics.inner_radius_mm, atol=1e-3) | np.isclose(end[:, 2], optics.floor_z_mm, atol=1e-3)).all()
    np.testing.assert_array_equal(np.isnan(traced.single_mm[..., 1]), np.isnan(traced.length_mm))


def test_the_written_program_reads_the_rays(tmp_path: Path) -> None:
    traced = rays.trace(seen(LEVEL), Optics.from_scene(SCENE), SCENE)
    (tmp_path / "rays").mkdir()
    traced.write(tmp_path / "rays" / "a.npz")
    (tmp_path / "rays.json").write_text(json.dumps({"pictures": [{"file": "images/a.png", "rays": "rays/a.npz"}]}))
    (tmp_path / "load_rays.py").write_text(rays.LOADER)
    [(file, read)] = runpy.run_path(str(tmp_path / "load_rays.py"))["load"](tmp_path)
    assert file == "images/a.png"
    for name in ("origin_mm", "direction", "length_mm", "single_mm"):
        np.testing.assert_array_equal(read[name], getattr(traced, name))
    shown = subprocess.run([sys.executable, tmp_path / "load_rays.py"], capture_output=True, text=True, check=True).stdout
    assert shown == f"images/a.png {np.isfinite(traced.length_mm).sum()} rays\n"


def test_bands_of_rows_give_the_same_rays(monkeypatch: pytest.MonkeyPatch) -> None:
    view, optics = seen(STEEP), Optics.from_scene(SCENE)
    whole = rays.trace(view, optics, SCENE)
    monkeypatch.setattr(rays, "_AT_ONCE", 7 * 200)  # 150 rows are no multiple of 7
    banded = rays.trace(view, optics, SCENE)
    for name in ("origin_mm", "direction", "length_mm", "single_mm"):
        np.testing.assert_array_equal(getattr(banded, name), getattr(whole, name))


def test_rays_of_the_example_method(tmp_path: Path) -> None:
    example = runpy.run_path(str(Path(__file__).parents[3] / "examples" / "methods" / "water_rays.py"))
    optics, centre, radius_mm, views = Optics.from_scene(SCENE), np.array([9.0, -6.0, -60.0]), 6.0, 6
    (tmp_path / "rays").mkdir()
    roots = 0
    for k in range(views):
        traced = rays.trace(seen(LEVEL @ frames.rotation_z(2.0 * np.pi * k / views)), optics, SCENE)
        traced.write(tmp_path / "rays" / f"{k}.npz")
        mask = np.linalg.norm(np.cross(centre - traced.origin_mm, traced.direction), axis=-1) < radius_mm  # NaN is not
        roots += mask.sum()
        Image.fromarray(np.where(mask, 255, 0).astype(np.uint8)).save(tmp_path / f"{k}.png")
    listed = [{"file": f"images/{k}.jpg", "rays": f"rays/{k}.npz"} for k in range(views)]
    (tmp_path / "rays.json").write_text(json.dumps({"pictures": listed}))
    (tmp_path / "load_rays.py").write_text(rays.LOADER)

    origin, direction, root = example["read"](tmp_path, tmp_path)
    away_mm = np.linalg.norm(np.cross(centre - origin, direction), axis=1)
    assert root.sum() == roots > 500
    assert away_mm[root].max() < radius_mm + 1e-3
    assert away_mm[~root].min() > radius_mm - 1e-3
    (low, high), radius = example["box_around"](origin, direction, root)
    assert (low < centre - radius_mm).all()
    assert (high > centre + radius_mm).all()
    assert radius < np.hypot(*centre[:2]) + radius_mm + 2.1

    last = np.isfinite(traced.length_mm)
    given, given_aim = traced.origin_mm[last].astype(float), traced.direction[last].astype(float)
    aimed_from, aim = example["centralised"](given, given_aim)
    far = np.argmax(np.linalg.norm(aim - aim[0], axis=1))
    across = np.column_stack([aim[0], -aim[far]])
    centre = aimed_from[0] + np.linalg.lstsq(across, aimed_from[far] - aimed_from[0], rcond=None)[0][0] * aim[0]
    assert np.linalg.norm(np.cross(centre - aimed_from, aim), axis=1).max() < 1e-3
    near = np.linalg.norm(example["nearest_to_axis"](given, given_aim)[:, :2], axis=1) < 35.0
    off_mm = 30.0 * np.linalg.norm(aim - given_aim, axis=1)[near]  # at 30 mm before and behind the axis
    assert 1.0 < np.sqrt((off_mm**2).mean()) < 2.5
