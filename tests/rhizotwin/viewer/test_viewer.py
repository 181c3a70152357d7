"""Selection, corrections, messages, views and several results of the viewer, without a browser."""

import shutil
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import viser

from rhizotwin.corrections import log
from rhizotwin.scenes.errors import UserError
from rhizotwin.viewer import capture, picking, scene3d, words
from rhizotwin.viewer.app import Viewer
from tests.rhizotwin import plant as plants
from tests.rhizotwin.viewer.conftest import started


def test_voxels_are_chosen_in_a_box_and_deleted_quickly(viewer: Viewer):
    before = viewer.shown.session.measure().volume_mm3
    viewer.select_box((-20.0, -20.0, -60.0), (20.0, 20.0, -45.0))
    assert len(viewer.voxels) > 200
    begin = time.process_time()
    viewer.delete()
    assert time.process_time() - begin < 3.0  # it takes 0.03 s
    assert viewer.shown.session.measure().volume_mm3 < 0.9 * before
    viewer.undo()
    assert viewer.shown.session.measure().volume_mm3 == before


def test_what_cannot_be_done_is_said(viewer: Viewer, monkeypatch: pytest.MonkeyPatch):
    def full(*_: object, **__: object) -> None:
        raise UserError("the disk is full")

    viewer.delete()
    assert viewer.message == "nothing was deleted, because nothing is selected"
    viewer.pair("join")
    assert "two roots must be selected" in viewer.message
    viewer.restore()
    assert viewer.message == "there are no deleted roots or voxels to restore"
    viewer.correct("delete roots", roots=[2])
    monkeypatch.setattr(log, "write", full)
    viewer.save()
    assert viewer.message == "the corrections could not be saved: the disk is full"
    assert viewer.unsaved() == 1
    monkeypatch.setattr(viewer, "_draw_surface", full)
    viewer.refresh()
    viewer._background.shutdown(wait=True)
    assert viewer.message == "the disk is full"


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
    points, inside = np.concatenate([root.points_mm for root in plant.roots]), {}
    for view in scene3d.VIEWS:
        position = viewer.scene.camera_position(view, aspect=0.8)
        forward = viewer.scene.home[0] - position
        forward /= np.linalg.norm(forward)
        right = np.cross(forward, [0.0, 0.0, 1.0])
        right /= np.linalg.norm(right)
        pose = np.eye(4)
        pose[:3, :3] = [right, np.cross(forward, right), forward]
        pose[:3, 3] = -pose[:3, :3] @ position
        inside[view] = bool(picking.Screen(pose, float(np.deg2rad(40.0)), 0.8).inside(points, (0.0, 0.0), (1.0, 1.0)).all())
    assert inside == dict.fromkeys(scene3d.VIEWS, True)


def test_a_turntable_camera_keeps_its_height_and_distance():
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


def inputs(running: Viewer) -> dict[str, Any]:
    """Return the controls of the panel by their labels."""
    return {getattr(one, "label", ""): one for one in running.served.server.gui._gui_input_handle_from_uuid.values()}


@pytest.mark.parametrize(
    ("file", "old", "new"),
    [("shape.npz", b"PK", b""), ("result.json", b'"dataset_sha256": "', b'"dataset_sha256": "0')],
    ids=["damaged", "another scan"],
)
def test_a_result_that_cannot_be_shown_leaves_the_earlier_one(
    plant: plants.Plant, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, file: str, old: bytes, new: bytes
):
    other = Path(shutil.copytree(plant.result, tmp_path / "day 2"))
    data = (other / file).read_bytes()
    assert old in data
    (other / file).write_bytes(data.replace(old, new))
    texts: list[viser.GuiHtmlHandle] = []
    add = viser.GuiApi.add_html
    monkeypatch.setattr(viser.GuiApi, "add_html", lambda *given, **more: texts.append(add(*given, **more)) or texts[-1])
    with started([plant.result, other], plant.dataset) as running:
        slider = inputs(running)["Result"]
        slider.value = 2
        running.refresh()
        assert (running.shown.name, slider.value) == (plant.result.name, 1)
        assert [words.note(name) in [text.content for text in texts] for name in running.names] == [True, False]
        assert str(other) in running.message
        running.load(0)
        assert running.message == ""


def test_each_result_has_its_own_pictures_and_layers(plant: plants.Plant, tmp_path: Path):
    moved = Path(shutil.copytree(plant.result, tmp_path / "moved")) / "result.json"
    moved.write_text(moved.read_text().replace(str(plant.dataset), str(tmp_path / "nowhere")))
    with started([moved.parent, plant.result], None) as running:
        shown = [inputs(running)[name] for name in ("Picture", "Canister, water and net pot", "Surface")]
        assert [one.visible for one in shown] == [False, False, True]
        running.load(1)
        assert [one.visible for one in shown] == [True, True, True]
