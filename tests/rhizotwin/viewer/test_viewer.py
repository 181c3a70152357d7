"""Selection, corrections, messages and views of the viewer, without a browser."""

import time

import numpy as np
import pytest

from rhizotwin.corrections import log
from rhizotwin.scenes.errors import UserError
from rhizotwin.viewer import capture, picking, scene3d
from rhizotwin.viewer.app import Viewer
from tests.rhizotwin import plant as plants


def test_voxels_are_chosen_in_a_box_and_deleted_quickly(viewer: Viewer):
    before = viewer.shown.session.measure().volume_mm3
    viewer.select_box((-20.0, -20.0, -60.0), (20.0, 20.0, -45.0))
    assert len(viewer.voxels) > 200
    begin = time.perf_counter()
    viewer.delete()
    assert time.perf_counter() - begin < 3.0  # 0.03 s by itself; other tests run beside it
    assert viewer.shown.session.measure().volume_mm3 < 0.9 * before
    viewer.undo()
    assert viewer.shown.session.measure().volume_mm3 == before


def test_what_cannot_be_done_is_said(viewer: Viewer):
    viewer.delete()
    assert viewer.message == "nothing was deleted, because nothing is selected"
    viewer.pair("join")
    assert "two roots must be selected" in viewer.message
    viewer.restore()
    assert viewer.message == "there are no deleted roots or voxels to restore"


def test_what_was_taken_away_last_comes_back_first(viewer: Viewer):
    before = viewer.shown.session.measure()
    viewer.correct("delete roots", roots=[1])
    viewer.correct("delete roots", roots=[2, 3])
    viewer.restore()
    assert sorted(viewer.shown.session.state.lines) == [0, 2, 3]
    viewer.restore()
    assert viewer.shown.session.measure().length_mm == pytest.approx(before.length_mm)
    rows = viewer.voxel_rows()[:50]
    viewer.correct("delete voxels", runs=[(int(row), 1) for row in rows])
    viewer.restore()
    assert not viewer.shown.session.state.gone.any()


def test_preset_views_show_the_whole_shape(viewer: Viewer, plant: plants.Plant):
    points = np.concatenate([root.points_mm for root in plant.roots])
    for view in scene3d.VIEWS:
        position = viewer.scene.camera_position(view, aspect=0.8)
        forward = viewer.scene.home[0] - position
        forward /= np.linalg.norm(forward)
        right = np.cross(forward, [0.0, 0.0, 1.0])
        right /= np.linalg.norm(right)
        pose = np.eye(4)
        pose[:3, :3] = [right, np.cross(forward, right), forward]
        pose[:3, 3] = -pose[:3, :3] @ position
        assert picking.Screen(pose, float(np.deg2rad(40.0)), 0.8).inside(points, (0.0, 0.0), (1.0, 1.0)).all(), view


def test_a_turntable_camera_keeps_its_height_and_looks_at_the_axis():
    position, centre = np.array([100.0, 0.0, 20.0]), np.array([1.0, 2.0, -30.0])
    frames = list(capture.orbit(np.array([1.0, 0.0, 0.0, 0.0]), position, centre, 8))
    distances = [np.linalg.norm(at[:2] - centre[:2]) for _, at in frames]
    assert distances == pytest.approx([distances[0]] * 8)
    assert [at[2] for _, at in frames] == pytest.approx([20.0] * 8)
    assert frames[4][1][:2] == pytest.approx(2.0 * centre[:2] - position[:2])


def test_the_panel_is_updated_before_the_scene_is_drawn(viewer: Viewer, monkeypatch: pytest.MonkeyPatch):
    viewer.wait()
    order: list[str] = []
    viewer.on_change.append(lambda: order.append("told"))
    for name in ("_draw", "_draw_surface", "_draw_selection"):
        monkeypatch.setattr(viewer, name, lambda name=name: order.append(name))
    viewer.correct("delete roots", roots=[3])
    viewer._background.shutdown(wait=True)
    assert order == ["told", "_draw", "_draw_surface"]
    order.clear()
    viewer.deselect()
    assert order == ["told", "_draw_selection"]


def test_a_surface_that_cannot_be_drawn_is_told(viewer: Viewer, monkeypatch: pytest.MonkeyPatch):
    def broken() -> None:
        raise UserError("shape.ply is not a readable mesh")

    monkeypatch.setattr(viewer, "_draw_surface", broken)
    viewer.refresh()
    viewer._background.shutdown(wait=True)
    assert viewer.message == "shape.ply is not a readable mesh"


def test_corrections_that_cannot_be_saved_are_reported(viewer: Viewer, monkeypatch: pytest.MonkeyPatch):
    def full(*_: object, **__: object) -> None:
        raise UserError("the disk is full")

    viewer.correct("delete roots", roots=[2])
    monkeypatch.setattr(log, "write", full)
    viewer.save()
    assert viewer.message == "the corrections could not be saved: the disk is full"
    assert viewer.unsaved() == 1
