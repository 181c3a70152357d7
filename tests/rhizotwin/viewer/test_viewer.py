"""What the viewer does without a browser: picking, pictures through the water, words."""

import socket
import time
from collections.abc import Iterator
from dataclasses import replace

import cv2
import numpy as np
import pytest
from websockets.datastructures import Headers
from websockets.http11 import Request

from rhizotwin.recon.optics import cameras
from rhizotwin.scenes import formatting
from rhizotwin.scenes.dataset import load_dataset
from rhizotwin.scenes.errors import UserError
from rhizotwin.stored.result_files import read_summary
from rhizotwin.through_water import Pictures
from rhizotwin.viewer import app, colours, guard, picking, words
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
    viewer.choose_box((-20.0, -20.0, -60.0), (20.0, 20.0, -45.0))
    assert len(viewer.voxels) > 200
    begin = time.perf_counter()
    viewer.delete()
    assert time.perf_counter() - begin < 3.0  # 0.03 s by itself; other tests run beside it
    assert viewer.shown.session.measure().volume_mm3 < 0.9 * before
    viewer.undo()
    assert viewer.shown.session.measure().volume_mm3 == before


def test_what_cannot_be_done_is_said(viewer: Viewer):
    viewer.delete()
    assert viewer.told == "nothing is chosen"
    viewer.pair("join")
    assert "choose two roots" in viewer.told
    viewer.restore()
    assert viewer.told == "nothing was taken away"


def test_pixels_are_those_of_the_reference(plant: plants.Plant):
    found = Pictures.of(load_dataset(plant.dataset), {"views": [], "rig": {}} | read_summary(plant.result))
    points = np.concatenate([root.points_mm for root in plant.roots])[::7]
    for place in (0, 3):
        px = found.pixels(place, points)
        reference, count = cameras.project(found.views[place], found.optics, points)
        assert (count == 1).all()
        assert px == pytest.approx(reference[:, 0], abs=1e-6)


def test_roots_drawn_over_pictures_lie_on_the_roots(viewer: Viewer):
    pictures, lines = viewer.shown.pictures, viewer.shown.session.state.lines
    assert pictures is not None
    drawn = pictures.drawn(0, lines, dict.fromkeys(lines, (255, 0, 0))).astype(int)
    plain = pictures.drawn(0, {}, {}).astype(int)  # eight times as large as the picture
    marked = (drawn != plain).any(axis=2)
    assert 50 < marked.sum() < 0.02 * marked.size
    roots = cv2.dilate((plain[..., 0] < 250).astype(np.uint8), np.ones((17, 17), np.uint8)) > 0  # within a pixel of the picture
    assert roots[marked].mean() > 0.98


def test_names_are_escaped_and_numbers_have_the_digits_they_deserve(viewer: Viewer):
    assert "&lt;b&gt;" in words.note(viewer.shown.session.summary["scene"])
    assert formatting.ml(137070.4, half_mm3=9000.0) == "137.1"
    assert formatting.ml(58.2967, half_mm3=11.7) == "0.058"
    assert "<script>" not in words.root(0, viewer.shown.session.state.lines, 0, ["<script>"])
    told = {"name": "tips", "value": 3.0, "interval": [2.0, 4.0], "trusted": False, "verdict": "<script>"}
    assert "<script>" not in words.traits(
        viewer.shown.traits(), corrected=False, summary=viewer.shown.session.summary | {"estimates": [told]}
    )


def test_standing_in_a_picture_hides_what_does_not_fit(viewer: Viewer):
    viewer.stand(2)
    assert viewer.standing == 2
    viewer.clicked(ray_to(np.array([0.0, 0.0, -30.0])))
    assert viewer.roots == []
    viewer.stand(None)
    assert viewer.standing is None


def test_what_is_cut_away_cannot_be_clicked_and_what_is_left_has_both_its_sides(viewer: Viewer, plant: plants.Plant):
    point = plant.roots[1].points_mm[30]
    viewer.cut_away(2, None, float(point[2]) - 2.0)
    viewer.clicked(ray_to(point))
    assert viewer.roots != [1]
    viewer.cut_away(2, None, None)
    viewer.clicked(ray_to(point))
    assert viewer.roots == [1]
    viewer.look.low_mm, viewer.look.high_mm = (-1e9, -1e9, float(point[2]) - 1.0), (1e9, 1e9, float(point[2]) + 1.0)
    parts = viewer.visible()[1]
    assert 0.0 < sum(part.length_mm for part in parts) < viewer.shown.session.state.lines[1].length_mm
    surface = viewer._cut(viewer.shown.surface_now())
    assert surface is not None
    for shown in (np.concatenate([part.points_mm for part in parts]), surface.vertices_mm):
        assert np.abs(shown[:, 2] - point[2]).max() <= 1.0


def test_measuring_needs_no_roots(viewer: Viewer, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(viewer, "strung", lambda: picking.Strung.of([]))  # as a print has none
    viewer.look.click = CLICKS[2]
    solid, rows = viewer.shown.session.measure().solid, viewer._voxel_rows()
    lowest, other = (solid.centre_mm[rows[k]] for k in (solid.centre_mm[rows, 2].argmin(), solid.centre_mm[rows, 0].argmax()))
    viewer.clicked(ray_to(lowest))
    viewer.clicked(ray_to(other))
    assert np.linalg.norm(viewer.measured[0] - viewer.measured[1]) == pytest.approx(np.linalg.norm(lowest - other), abs=1.0)


def test_what_was_taken_away_last_comes_back_first(viewer: Viewer):
    before = viewer.shown.session.measure()
    viewer.do("delete roots", roots=[1])
    viewer.do("delete roots", roots=[2, 3])
    viewer.restore()
    assert sorted(viewer.shown.session.state.lines) == [0, 2, 3]
    viewer.restore()
    assert viewer.shown.session.measure().length_mm == pytest.approx(before.length_mm)
    rows = viewer._voxel_rows()[:50]
    viewer.do("delete voxels", runs=[(int(row), 1) for row in rows])
    viewer.restore()
    assert not viewer.shown.session.state.gone.any()


def test_colours_tell_uncertainty(viewer: Viewer):
    lines = dict(viewer.shown.session.state.lines)
    shade, legend = colours.colouring("uncertainty", lines)
    certain = replace(lines[1], sigma_mm=np.zeros(len(lines[1].points_mm)))
    assert (shade(1, certain) == [68, 1, 84]).all()  # viridis begins so
    assert (shade(1, replace(lines[1], sigma_mm=lines[1].diameters_mm)) == [253, 231, 37]).all()
    assert (shade(1, replace(lines[1], sigma_mm=None)) == colours.UNKNOWN).all()
    assert "yellow" in legend
    unknown = {number: replace(line, sigma_mm=None) for number, line in lines.items()}
    assert "not known" in colours.colouring("uncertainty", unknown)[1]
    assert "±" in words.root(1, lines, 1)
    assert "±" not in words.root(1, unknown, 1)


def test_traits_follow_corrections(viewer: Viewer):
    assert viewer.shown.traits().roots == 4
    assert viewer.shown.traits().total_length_mm == pytest.approx(viewer.shown.session.measure().length_mm)
    told: list[str] = []
    viewer.on_drawn.append(lambda: told.append(words.traits(viewer.shown.traits(), corrected=True, summary=viewer.shown.session.summary)))
    viewer.do("delete roots", roots=[3])
    assert viewer.shown.traits().roots == 3
    assert "<td>3<br>" in told[-1]
    viewer.undo()


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


def test_the_panel_is_told_before_the_scene_is_drawn(viewer: Viewer, monkeypatch: pytest.MonkeyPatch):
    order: list[str] = []
    viewer.on_change.append(lambda: order.append("told"))
    for name in ("_draw", "_draw_surface", "_draw_chosen"):
        monkeypatch.setattr(viewer, name, lambda name=name: order.append(name))
    viewer.do("delete roots", roots=[3])
    viewer._surfaces.shutdown(wait=True)
    assert order == ["told", "_draw", "_draw_surface"]
    order.clear()
    viewer.choose_nothing()
    assert order == ["told", "_draw_chosen"]


def test_a_surface_that_cannot_be_drawn_is_told(viewer: Viewer, monkeypatch: pytest.MonkeyPatch):
    def broken() -> None:
        raise UserError("shape.ply is not a readable mesh")

    monkeypatch.setattr(viewer, "_draw_surface", broken)
    viewer.refresh()
    viewer._surfaces.shutdown(wait=True)
    assert viewer.told == "shape.ply is not a readable mesh"
