"""What the viewer does without a browser: picking, pictures through the water, words."""

import json
import shutil
import socket
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import viser
from websockets.datastructures import Headers
from websockets.http11 import Request

from rhizotwin import root_colours
from rhizotwin.corrections import log, session
from rhizotwin.recon.calibration.cameras import BareUncertainty, Camera, Cameras
from rhizotwin.recon.optics import cameras
from rhizotwin.recon.optics.refraction import Optics
from rhizotwin.recon.results.calibration_summary import summarize_cameras
from rhizotwin.scenes import formatting, frames
from rhizotwin.scenes.dataset import load_dataset
from rhizotwin.scenes.errors import UserError
from rhizotwin.stored.result_files import read_summary
from rhizotwin.through_water import Pictures
from rhizotwin.viewer import app, capture, guard, picking, scene3d, words
from rhizotwin.viewer.app import Viewer
from rhizotwin.viewer.drawing import CLICKS
from tests.rhizotwin import plant as plants


@pytest.fixture(scope="module")
def plant(tmp_path_factory: pytest.TempPathFactory) -> plants.Plant:
    return plants.make(tmp_path_factory.mktemp("plant"), name="a *plant* <b>")


@pytest.fixture
def viewer(plant: plants.Plant) -> Iterator[Viewer]:
    running = app.start([plant.result], plant.dataset, port=8290)
    yield running
    running.served.server.stop()


def ray_to(point: np.ndarray) -> picking.Ray:
    eye = np.array([300.0, -200.0, 20.0])
    return picking.Ray(eye, (point - eye) / np.linalg.norm(point - eye))


def test_a_click_finds_the_root_it_meets_first(viewer: Viewer, plant: plants.Plant):
    for number in range(4):
        point = plant.roots[number].points_mm[30]
        viewer.clicked(ray_to(point))
        assert viewer.roots == [number]
    viewer.clicked(ray_to(np.array([60.0, 60.0, -100.0])))
    assert viewer.roots == []


def test_clicks_measure_cut_and_end(viewer: Viewer, plant: plants.Plant):
    a, b = plant.roots[1].points_mm[30], plant.roots[2].points_mm[30]
    viewer.look.click = CLICKS[2]
    viewer.clicked(ray_to(a))
    viewer.clicked(ray_to(b))
    assert np.linalg.norm(viewer.measured[0] - viewer.measured[1]) == pytest.approx(np.linalg.norm(a - b), abs=1.0)
    viewer.look.click = CLICKS[3]
    viewer.clicked(ray_to(plant.roots[0].points_mm[15]))
    assert len(viewer.shown.session.state.lines) == 5
    viewer.look.click = CLICKS[4]
    viewer.clicked(ray_to(a))
    way = np.linalg.norm(np.diff(plant.roots[1].points_mm, axis=0), axis=1).sum()
    assert viewer.shown.session.state.lines[1].length_mm < 0.9 * way


def test_a_click_finds_the_voxel_that_its_ray_enters_first():
    centre = np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [2.0, 5.0, 0.0]])
    half = np.full(3, 0.5)
    hit = picking.voxel_at(centre, half, picking.Ray(np.array([10.0, 0.4, 0.0]), np.array([-1.0, 0.0, 0.0])))
    assert hit is not None
    assert hit[0] == 1
    assert hit[1] == pytest.approx([2.5, 0.4, 0.0])
    assert picking.voxel_at(centre, half, picking.Ray(np.array([10.0, 0.6, 0.0]), np.array([-1.0, 0.0, 0.0]))) is None


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


def test_pixels_are_those_of_the_reference(plant: plants.Plant):
    found = Pictures.of(load_dataset(plant.dataset), {"views": [], "rig": {}} | read_summary(plant.result))
    points = np.concatenate([root.points_mm for root in plant.roots])[::7]
    for place in (0, 3):
        px = found.pixels(place, points)
        reference, count = cameras.project(found.views[place], found.optics, points)
        assert (count == 1).all()
        assert px == pytest.approx(reference[:, 0], abs=1e-6)


def test_stored_cameras_project_points_like_the_calibrated_cameras(plant: plants.Plant):
    """The scale of the scene is 0.22 mm per pixel, that of the pictures 0.11; the roots sway by 0.3 mm at their tips."""
    dataset = load_dataset(plant.dataset)
    given = replace(dataset.scene.camera, kind="telecentric", mm_per_px=0.22)
    scene = replace(dataset.scene, camera=given)
    lens = replace(given, mm_per_px=0.11)
    pose = lens.pinhole_pose(frames.level_camera(distance_mm=400.0, height_mm=-60.0, tilt_deg=0.0))
    one = Camera(file=dataset.frames[0].file, ring=0, used=True, cam_from_canister=pose, sway=(0.0, 0.003, 0.0))
    bare = BareUncertainty(scale=1e-3, azimuth_rad=1e-3, lift_mm=0.1, mm_per_px=0.11)
    made = Cameras(lens=lens.as_pinhole(), optics=Optics.from_scene(scene), all=(one,), order=(0,), bare=bare)
    rig = summarize_cameras(made)
    stored = {"file": one.file, "used": True, "cam_from_canister": pose.tolist(), "sway": list(one.sway)}
    found = Pictures.of(replace(dataset, scene=scene), {"views": [stored], "rig": rig})
    points = np.array([[0.0, 2.0, -80.0], [3.0, -4.0, -120.0]])
    assert found.pixels(0, points) == pytest.approx(cameras.project_inner(made.views[0], made.optics, points), abs=1e-9)
    del rig["mm_per_px"], stored["sway"]  # as in results of earlier versions
    assert Pictures.of(replace(dataset, scene=scene), {"views": [stored], "rig": rig}).views[0].camera == given.as_pinhole()


def test_roots_drawn_over_pictures_lie_on_the_roots(viewer: Viewer):
    pictures, lines = viewer.shown.pictures, viewer.shown.session.state.lines
    assert pictures is not None
    drawn = pictures.draw_outline(0, viewer.shown.surface(), lines).astype(int)
    plain = pictures.draw_outline(0, None, {}).astype(int)  # eight times as large as the picture
    marked = (drawn != plain).any(axis=2)
    assert 50 < marked.sum() < 0.02 * marked.size
    roots = cv2.dilate((plain[..., 0] < 250).astype(np.uint8), np.ones((17, 17), np.uint8)) > 0  # within a pixel of the picture
    assert roots[marked].mean() > 0.98


def test_names_are_escaped_and_numbers_have_the_digits_they_deserve(viewer: Viewer):
    assert "&lt;b&gt;" in words.note(viewer.shown.session.summary["scene"])
    assert formatting.ml(137070.4, half_mm3=9000.0) == "137.1"
    assert formatting.ml(58.2967, half_mm3=11.7) == "0.058"
    assert "<script>" not in words.history([replace(log.edit("cut"), who="<script>")])
    told = {"name": "tips", "value": 3.0, "interval": [2.0, 4.0], "trusted": False, "verdict": "<script>"}
    assert "<script>" not in words.traits(viewer.shown.traits(), edited=False, summary=viewer.shown.session.summary | {"estimates": [told]})


def test_a_picture_hides_the_3d_view(viewer: Viewer):
    viewer.enter_picture(2)
    assert viewer.picture == 2
    viewer.clicked(ray_to(np.array([0.0, 0.0, -30.0])))
    assert viewer.roots == []
    viewer.enter_picture(None)
    assert viewer.picture is None


def test_what_is_cut_away_cannot_be_clicked_and_what_is_left_has_both_its_sides(viewer: Viewer, plant: plants.Plant):
    point = plant.roots[1].points_mm[30]
    viewer.clip(2, None, float(point[2]) - 2.0)
    viewer.clicked(ray_to(point))
    assert viewer.roots != [1]
    viewer.clip(2, None, None)
    viewer.clicked(ray_to(point))
    assert viewer.roots == [1]
    viewer.look.low_mm, viewer.look.high_mm = (-1e9, -1e9, float(point[2]) - 1.0), (1e9, 1e9, float(point[2]) + 1.0)
    parts = viewer.visible()[1]
    assert 0.0 < sum(part.length_mm for part in parts) < viewer.shown.session.state.lines[1].length_mm
    surface = viewer._clip_mesh(viewer.shown.surface())
    assert surface is not None
    for shown in (np.concatenate([part.points_mm for part in parts]), surface.vertices_mm):
        assert np.abs(shown[:, 2] - point[2]).max() <= 1.0


def test_measuring_needs_no_roots(viewer: Viewer, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(viewer, "nodes", lambda: picking.Nodes.of([]))  # as a print has none
    viewer.look.click = CLICKS[2]
    solid, rows = viewer.shown.session.measure().solid, viewer.voxel_rows()
    lowest, other = (solid.centre_mm[rows[k]] for k in (solid.centre_mm[rows, 2].argmin(), solid.centre_mm[rows, 0].argmax()))
    viewer.clicked(ray_to(lowest))
    viewer.clicked(ray_to(other))
    assert np.linalg.norm(viewer.measured[0] - viewer.measured[1]) == pytest.approx(np.linalg.norm(lowest - other), abs=1.0)


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


def test_colours_tell_uncertainty(viewer: Viewer):
    lines = dict(viewer.shown.session.state.lines)
    shade, legend = root_colours.colour_roots("uncertainty", lines)
    certain = replace(lines[1], sigma_mm=np.zeros(len(lines[1].points_mm)))
    assert (shade(1, certain) == [68, 1, 84]).all()  # viridis begins so
    assert (shade(1, replace(lines[1], sigma_mm=lines[1].diameters_mm)) == [253, 231, 37]).all()
    assert (shade(1, replace(lines[1], sigma_mm=None)) == root_colours.UNKNOWN).all()
    assert legend.ends == ("diameter ±0 %", "±25 % or more (90 %)")
    unknown = {number: replace(line, sigma_mm=None) for number, line in lines.items()}
    assert root_colours.colour_roots("uncertainty", unknown)[1].swatches == ((root_colours.UNKNOWN, "uncertainty not available"),)
    assert "±" in words.root(1, lines, 1)
    assert "±" not in words.root(1, unknown, 1)


def test_traits_follow_corrections(viewer: Viewer):
    assert viewer.shown.traits().roots == 4
    assert viewer.shown.traits().total_length_mm == pytest.approx(viewer.shown.session.measure().length_mm)
    told: list[str] = []
    viewer.on_measured.append(lambda: told.append(words.traits(viewer.shown.traits(), edited=True, summary=viewer.shown.session.summary)))
    viewer.correct("delete roots", roots=[3])
    viewer.wait()
    assert viewer.shown.traits().roots == 3
    assert "<td>3<br>" in told[-1]
    viewer.undo()


def test_traits_that_were_not_reliable_are_not_called_unassessed_after_corrections(viewer: Viewer):
    found, summary = viewer.shown.traits(), viewer.shown.session.summary
    length = found.total_length_mm
    estimate = {
        "name": "total_length_mm",
        "value": length,
        "interval": [0.9 * length, 2.0 * length],
        "trusted": False,
        "verdict": "too thin",
    }
    table = words.traits(found, edited=True, summary=summary | {"estimates": [estimate]})
    assert table.count("<small>not reliable</small>") == 1
    assert table.count("not assessed after corrections") > 5
    refused = words.traits(found, edited=True, summary=summary | {"volume_trusted": False})
    assert "not assessed" not in refused


@pytest.mark.parametrize(
    ("trusted", "shown"), [(True, "<b>0.95 ml</b> (-5.00 %), 12 mm"), (False, "0.95 ml (-5.00 %), which is not reliable")]
)
def test_a_corrected_volume_is_not_more_reliable_than_that_of_the_result(trusted: bool, shown: str):
    summary = {"volume_mm3": 1000.0, "volume_interval_mm3": [900.0, 1100.0], "volume_trusted": trusted, "volume_verdict": "blurred"}
    measured = session.Measured(volume_mm3=950.0, length_mm=12.0, roots=2, volumes_mm3=np.zeros(0), solid=None)
    assert f"after corrections: {shown}" in words.volume(summary, measured, edits=1)


def test_the_outline_is_that_of_the_union(viewer: Viewer):
    pictures, lines = viewer.shown.pictures, viewer.shown.session.state.lines
    assert pictures is not None
    plain = pictures.draw_outline(0, None, {})
    outline = (pictures.draw_outline(0, None, lines) != plain).any(axis=2)
    mask = np.zeros(plain.shape[:2], np.uint8)
    pictures._fill_tubes(mask, 0, lines, plain.shape[1] // 200, thickest_mm=np.inf)
    inside = cv2.erode(mask, np.ones((7, 7), np.uint8)) > 0
    assert inside.sum() > 1000
    assert not outline[inside].any()  # no edge of one tube inside another


def test_selected_roots_have_an_outline_of_their_own(viewer: Viewer):
    pictures, lines = viewer.shown.pictures, viewer.shown.session.state.lines
    assert pictures is not None
    drawn = pictures.draw_outline(0, viewer.shown.surface(), lines, selected=[1]).astype(int)
    assert ((drawn[..., 2] - drawn[..., 0]) > 100).sum() > 50  # blue


def test_corrections_are_listed_and_undone_back_to_any_of_them(viewer: Viewer):
    for number in (1, 2, 3):
        viewer.correct("delete roots", roots=[number])
    text = words.history(viewer.shown.session.log.edits)
    assert "<b>3 corrections</b>" in text
    assert text.index("delete roots (3)") < text.index("delete roots (1)")
    viewer.undo_to(1)
    assert sorted(viewer.shown.session.state.lines) == [0, 2, 3]
    viewer.redo()
    assert sorted(viewer.shown.session.state.lines) == [0, 3]
    viewer.undo_to(0)


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


@pytest.mark.parametrize("twice", ["Host: a", "Origin: http://a", "Cookie: a=b", "Upgrade: x"])
def test_a_header_that_is_there_twice_is_no_error(twice: str):
    headers = Headers([("Host", "here:1"), ("Upgrade", "websocket"), ("Origin", "http://here:1"), ("Cookie", "rhizotwin_1=t")])
    headers[twice.partition(":")[0]] = twice.partition(": ")[2]
    refused = guard.answer("t", lambda *_: None, None, Request("/", headers))
    assert twice[0] == "U" or (refused is not None and refused.status_code == 403)


def test_pages_wait_for_what_is_shown():
    served = guard.serve(port=8390)
    try:
        with socket.create_connection((served.host, served.port), timeout=20.0) as line:
            line.sendall(
                f"GET / HTTP/1.1\r\nHost: {served.host}:{served.port}\r\nOrigin: http://{served.host}:{served.port}\r\n"
                f"Cookie: rhizotwin_{served.port}={served.token}\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n"
                "Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n".encode()
            )
            line.settimeout(0.3)
            with pytest.raises(TimeoutError):
                line.recv(100)
            served.open.set()
            line.settimeout(20.0)
            assert line.recv(100).startswith(b"HTTP/1.1 101")
    finally:
        served.stop()


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


@pytest.mark.parametrize("fault", ["damaged", "another scan"])
def test_a_result_that_cannot_be_shown_leaves_the_earlier_one_with_its_name(
    plant: plants.Plant, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fault: str
):
    other = tmp_path / "day 2"
    shutil.copytree(plant.result, other)
    if fault == "damaged":
        (other / "shape.npz").write_bytes(b"")
    else:
        summary = json.loads((other / "result.json").read_text())
        (other / "result.json").write_text(json.dumps(summary | {"dataset_sha256": "of another scan"}))
    texts: list[viser.GuiHtmlHandle] = []
    add = viser.GuiApi.add_html
    monkeypatch.setattr(viser.GuiApi, "add_html", lambda *given, **more: texts.append(add(*given, **more)) or texts[-1])
    running = app.start([plant.result, other], plant.dataset, port=8290)
    try:
        (slider,) = [one for one in running.served.server.gui._gui_input_handle_from_uuid.values() if getattr(one, "label", "") == "Result"]
        slider.value = 2
        running.refresh()
        assert (running.shown.name, slider.value) == (plant.result.name, 1)
        assert [words.note(name) in [text.content for text in texts] for name in running.names] == [True, False]
        assert str(other) in running.message
        running.load(0)
        assert running.message == ""
    finally:
        running.served.stop()


def test_each_result_has_its_own_pictures_and_layers(plant: plants.Plant, tmp_path: Path):
    moved = tmp_path / "moved"
    shutil.copytree(plant.result, moved)
    summary = json.loads((moved / "result.json").read_text())
    (moved / "result.json").write_text(json.dumps(summary | {"dataset": str(tmp_path / "nowhere")}))
    (plant.result / "result.json").write_text(json.dumps(summary | {"dataset": str(plant.dataset)}))
    running = app.start([moved, plant.result], None, port=8290)
    try:
        handles = {getattr(one, "label", ""): one for one in running.served.server.gui._gui_input_handle_from_uuid.values()}
        names = ("Picture", "Canister, water and net pot", "Surface")
        assert [handles[name].visible for name in names] == [False, False, True]
        running.load(1)
        assert [handles[name].visible for name in names] == [True, True, True]
    finally:
        running.served.stop()
        (plant.result / "result.json").write_text(json.dumps(summary))
