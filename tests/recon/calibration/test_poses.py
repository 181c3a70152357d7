"""Poses from corners with known truth: the rig pools its views, names what does not fit, and knows how well it knows."""

from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import mitsuba as mi
import numpy as np
import pytest

from rhizotwin.recon.calibration.cameras import Cameras
from rhizotwin.recon.calibration.find_cameras import find_cameras
from rhizotwin.recon.calibration.markers import Markers
from rhizotwin.recon.calibration.poses import find_poses
from rhizotwin.recon.optics import projection
from rhizotwin.recon.optics.cameras import cam_pixels, matrix, project_inner
from rhizotwin.recon.optics.projection import ViewBank
from rhizotwin.recon.read_pictures import Pictures
from rhizotwin.scenes import frames, plan
from rhizotwin.scenes.dataset import Dataset, Frame
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Canister, CapturePlan, Ring, Scene, Turntable, Water
from rhizotwin.scenes.monitor import Monitor
from tests.recon.hull import exact_pictures

SCENE = Scene()
CORNER_PX = 0.05


def shoot(scene: Scene, pose: frames.Array, rng: np.random.Generator) -> Markers:
    """Project the markers that face the camera, with noise."""
    centre, lens = frames.invert(pose)[:3, 3], (matrix(scene.camera), np.array(scene.camera.distortion))
    ids, corners = [], []
    for marker_id, points in plan.marker_corners(scene.strip, scene.net_pot).items():
        outward, sight = points.mean(axis=0) * [1.0, 1.0, 0.0], centre - points.mean(axis=0)
        if outward @ sight > 0.4 * np.linalg.norm(outward) * np.linalg.norm(sight):
            px = cv2.projectPoints(points, cv2.Rodrigues(pose[:3, :3])[0], pose[:3, 3], *lens)[0]
            ids.append(marker_id)
            corners.append(px.reshape(4, 2) + rng.normal(0.0, CORNER_PX, (4, 2)))
    covariance = np.tile(np.eye(8) * CORNER_PX**2, (len(ids), 1, 1))
    return Markers(ids=np.array(ids), corners_px=np.array(corners), covariance_px2=covariance)


@dataclass
class Scan:
    """Markers of views whose cameras are known."""

    scene: Scene
    poses: list[frames.Array]
    markers: list[Markers]
    captured: list[Frame]

    def found(self, **options: bool):
        """Return the poses found."""
        return find_poses(self.markers, self.scene, self.captured, **options)

    def errors(self, found) -> np.ndarray:
        """Return (V, 2) of mm and degrees."""
        pairs = zip(found.views, self.poses, strict=True)
        return np.array([frames.pose_error(view.cam_from_canister, pose) for view, pose in pairs if view.used])


def scan(*, rings: tuple[Ring, ...] = (Ring(views=12),), jitter: float = 0.0) -> Scan:
    """Make a bench-like scan: arm wrong for each ring, table wrong for each view, canister tilted and off the axis."""
    rng, scene = np.random.default_rng(1), Scene(plan=CapturePlan(rings=rings))
    table_from_canister = frames.from_rotvec(np.array([0.006, -0.005, 0.0]), np.array([0.8, -0.6, 0.0]))
    arms = [frames.from_rotvec(rng.normal(0.0, 0.005, 3), rng.normal(0.0, 1.0, 3)) for _ in rings]
    made = Scan(scene, [], [], [])
    for view in plan.views(scene):
        turned = plan.rig_from_table(scene, view.table_deg + rng.normal(0.0, 0.05)) @ table_from_canister
        own = frames.from_rotvec(rng.normal(0.0, jitter * 0.01, 3), rng.normal(0.0, jitter, 3))
        made.poses.append(own @ arms[view.ring] @ view.cam_from_rig @ turned)
        made.markers.append(shoot(scene, made.poses[-1], rng))
        made.captured.append(Frame(file=f"images/{view.index:02d}.png", sha256="", ring=view.ring, table_deg=view.table_deg))
    return made


def test_all_views_beat_single_views_and_know_their_errors():
    made = scan()
    found = made.found()
    alone, together = made.errors(made.found(single_view=True)), made.errors(found)
    assert np.all(np.median(together, axis=0) < 0.5 * np.median(alone, axis=0))
    assert np.all(np.median(together, axis=0) < [0.04, 0.01])
    assert found.rings[0].own_mm < 0.01
    assert found.before_px > 10.0 * found.after_px
    np.testing.assert_allclose(found.table_from_canister[:2, 3], [0.8, -0.6], atol=0.02)
    np.testing.assert_allclose(frames.to_rotvec(found.table_from_canister)[:2], [0.006, -0.005], atol=1e-4)
    assert found.focal_scale == pytest.approx(1.0, abs=1e-9)  # chance is not believed
    off = [view.cam_from_canister @ frames.invert(pose) for view, pose in zip(found.views, made.poses, strict=True)]
    steps = [np.concatenate([frames.to_rotvec(one), one[:3, 3]]) for one in off]
    squares = [step @ np.linalg.solve(view.covariance, step) for view, step in zip(found.views, steps, strict=True)]
    assert max(squares) < 30.0  # chi square with 6 degrees of freedom: 30 in 1 of 25000
    sigma = np.median([view.position_sigma_mm for view in found.views])
    assert 0.2 * sigma < np.median(together[:, 0]) < 3.0 * sigma


def test_a_camera_that_moves_keeps_the_accuracy_of_single_views():
    made = scan(jitter=0.5)
    found, alone = made.found(), made.errors(made.found(single_view=True))
    assert len(made.errors(found)) == len(made.poses)
    assert np.all(np.median(made.errors(found), axis=0) < 1.3 * np.median(alone, axis=0))
    assert 0.2 < found.rings[0].own_mm < 1.0


def test_pictures_without_table_angles_from_anywhere():
    rng = np.random.default_rng(4)
    poses = []
    for angle in (0.3, 1.9, 4.0, 5.5):
        camera = frames.level_camera(distance_mm=rng.uniform(350, 450), height_mm=rng.uniform(-60, 80), tilt_deg=rng.uniform(-3, 9))
        poses.append(frames.from_rotvec(rng.normal(0.0, 0.1, 3), np.zeros(3)) @ camera @ frames.rotation_z(angle))
    made = Scan(SCENE, poses, [shoot(SCENE, pose, rng) for pose in poses], [Frame(file=f"{k}.png", sha256="") for k in range(4)])
    found = made.found()
    assert all(view.used for view in found.views)
    assert np.max(made.errors(found)) < 1.5 * np.max(made.errors(made.found(single_view=True)))
    assert found.views[0].table_deg is None


def test_unusable_views_are_left_out_and_wrong_corners_harmless():
    made = scan()
    few = made.markers[3]
    made.markers[3] = Markers(ids=few.ids[:3], corners_px=few.corners_px[:3])
    made.markers[6] = Markers(ids=few.ids[:0], corners_px=few.corners_px[:0], diagnosis="markers of another strip: ...")
    moved = frames.from_rotvec(np.array([0.004, 0.0, 0.003]), np.array([0.4, -1.0, 0.5])) @ made.poses[5]
    made.markers[5] = shoot(made.scene, moved, np.random.default_rng(7))
    made.markers[2].corners_px[3] += 4.0
    made.markers[4].corners_px[[1, 6]] = made.markers[4].corners_px[[6, 1]]
    found = made.found()
    assert [k for k, view in enumerate(found.views) if not view.used] == [3, 5, 6]
    assert found.views[3].reason == "only 3 markers were found, at least 4 are needed"
    assert {"moved,", "px"} <= set(found.views[5].reason.split())
    assert found.views[6].reason.startswith("markers of another strip")
    assert made.errors(found)[:, 0].max() < 0.08
    assert np.median(made.errors(found)[:, 0]) < 0.04


def test_no_views_and_ids_that_run_the_other_way_are_refused():
    made = scan(rings=(Ring(views=3),))
    columns = made.scene.strip.columns
    for k, one in enumerate(made.markers):
        other_way = np.argsort(one.ids // columns * columns + columns - 1 - one.ids % columns)
        made.markers[k] = Markers(ids=np.sort(one.ids), corners_px=one.corners_px[other_way])
    with pytest.raises(UserError):
        made.found()
    made.markers = [Markers(ids=np.zeros(0, int), corners_px=np.zeros((0, 4, 2)), diagnosis="markers of another strip: ids 700")] * 3
    with pytest.raises(UserError, match=r"images/00\.png: markers of another strip"):
        made.found()


def test_a_table_that_turns_the_other_way_is_said():
    made = scan(rings=(Ring(views=9),))
    wrong = Scene(turntable=Turntable(direction=-1), plan=made.scene.plan)
    found = find_poses(made.markers, wrong, made.captured)
    assert np.median(made.errors(found)[:, 0]) < 0.1
    assert "turntable.direction" in found.warnings[0]


def test_a_camera_placed_anew_within_a_ring_gets_its_own_pose():
    made, rng = scan(rings=(Ring(views=16),)), np.random.default_rng(3)
    planned = plan.views(made.scene)[0].cam_from_rig
    moved = frames.from_rotvec(np.array([0.004, -0.01, 0.003]), np.array([4.0, -3.0, 2.0])) @ planned
    for k, frame in enumerate(made.captured):
        cam_from_rig, rezeroed_deg, placement = (moved, 0.8, 1) if k >= 10 else (planned, 0.0, 0)
        made.poses[k] = cam_from_rig @ plan.rig_from_table(made.scene, frame.table_deg + rezeroed_deg)
        made.markers[k] = shoot(made.scene, made.poses[k], rng)
        made.captured[k] = replace(frame, placement=placement)
    found = made.found()
    assert [(ring.ring, ring.placement) for ring in found.rings] == [(0, 0), (0, 1)]
    assert all(view.used for view in found.views)
    assert np.median(made.errors(found)[:, 0]) < 0.05
    assert max(ring.own_mm for ring in found.rings) < 0.05
    np.testing.assert_allclose(found.table_from_canister, np.eye(4), atol=0.05)
    as_one = find_poses(made.markers, made.scene, [replace(frame, placement=0) for frame in made.captured])
    assert not all(view.used for view in as_one.views) or as_one.rings[0].own_mm > 0.2


def test_a_lens_that_was_focused_after_its_calibration_is_found():
    made, rng = scan(rings=(Ring(views=16),)), np.random.default_rng(4)
    focused = replace(made.scene, camera=SCENE.camera.focused(1.004))
    made.markers = [shoot(focused, pose, rng) for pose in made.poses]
    found = made.found()
    assert found.focal_scale == pytest.approx(1.004, abs=4.0 * found.focal_sigma)
    assert found.focal_sigma < 0.0004
    assert np.median(made.errors(found)[:, 0]) < 0.2


def given(folder: Path, scene: Scene, poses: list[np.ndarray], *, masks: bool) -> Cameras:
    """Return the cameras of pictures, or of silhouettes, whose poses are given."""
    listed = tuple(Frame(file="", sha256="", cam_from_canister=exact_pictures.rows(pose)) for pose in poses)
    dataset = Dataset(folder=folder, scene=scene, frames=listed, masks=masks)
    return find_cameras(Pictures(dataset=dataset, frames=listed, images=()), monitor=Monitor())


def filled(n: float, **changes: object) -> Scene:
    return replace(Scene(), canister=Canister(n_wall=n), water=Water(n_water=n), **changes)


def test_a_camera_straight_above_silhouettes_in_air_sees_all(tmp_path: Path) -> None:
    scene = filled(1.0)
    down = np.array([[0.0, 1.0, 0.0, 0.0], [1.0, 0.0, 0.0, -0.5], [0.0, 0.0, -1.0, 350.0], [0.0, 0.0, 0.0, 1.0]])
    poses = [down @ frames.rotation_z(turn) for turn in (0.0, 1.0, 2.0)]
    cameras = given(tmp_path, scene, poses, masks=True)
    points = np.random.default_rng(0).uniform([-45.0, -45.0, -110.0], [45.0, 45.0, -20.0], (500, 3)).astype(np.float32).astype(float)
    expected = cam_pixels(scene.camera, frames.apply(poses[1], points))
    np.testing.assert_allclose(project_inner(cameras.views[1], cameras.optics, points), expected, atol=1e-9)
    bank, views = ViewBank.pack(cameras.views, cameras.optics), mi.UInt32(np.ones(500))
    found = projection.project(bank, views, mi.Point3f(points.T.astype(np.float32)), mi.Bool([True] * 500))
    assert np.array(found.visible).all()
    np.testing.assert_allclose(np.array(found.px).T, expected, atol=1e-3)


@pytest.mark.parametrize(("n_water", "masks", "top_seen"), [(1.0, True, True), (1.0, False, False), (1.333, True, False)])
def test_silhouettes_made_in_air_show_what_lies_under_the_rim(tmp_path: Path, n_water: float, masks: bool, top_seen: bool) -> None:
    scene = filled(n_water, plan=CapturePlan(rings=(Ring(views=5, height_mm=150.0, tilt_deg=25.0),)))
    poses = [view.cam_from_canister for view in exact_pictures.views_of(scene)]
    cameras = given(tmp_path, scene, poses, masks=masks)
    top = np.array([0.0, 0.0, scene.net_pot.grid_z_mm - 1.0])
    bank = ViewBank.pack(cameras.views, cameras.optics)
    found = projection.project(bank, mi.UInt32(np.arange(5)), mi.Point3f(*map(mi.Float, top)), mi.Bool([True] * 5))
    assert np.array(found.visible).tolist() == [top_seen] * 5
    if top_seen:
        expected = [cam_pixels(scene.camera, frames.apply(pose, top[None]))[0] for pose in poses]
        np.testing.assert_allclose(np.array(found.px).T, expected, atol=1e-3)
