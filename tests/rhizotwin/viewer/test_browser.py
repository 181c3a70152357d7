"""The viewer in a real browser: the first picture, picking, correcting, saving, and two browsers with one state."""

import io
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from PIL import Image, ImageSequence

from rhizotwin.corrections import corrected, log
from rhizotwin.corrections.session import Session
from rhizotwin.viewer import capture
from rhizotwin.viewer.app import Viewer, screen_of
from tests.rhizotwin import plant as plants
from tests.rhizotwin.browser import PATIENCE_MS, until
from tests.rhizotwin.viewer.conftest import started

pytestmark = pytest.mark.slow

WIDE, HIGH = 1100, 400
LARGEST = """() => [...document.querySelectorAll("canvas")].map(c => c.getBoundingClientRect())
    .map(b => ({x: b.x, y: b.y, width: b.width, height: b.height})).sort((a, b) => b.width * b.height - a.width * a.height)[0]"""
"""The canvas that the scene is drawn on."""
OWN = ("http://127.0.0.1", "ws://127.0.0.1", "data:", "blob:")


@pytest.fixture(scope="module")
def fibrous(tmp_path_factory: pytest.TempPathFactory) -> plants.Plant:
    return plants.make(tmp_path_factory.mktemp("fibrous"), fibre=True)


@pytest.fixture
def viewer(fibrous: plants.Plant, tmp_path: Path) -> Iterator[Viewer]:
    with started([Path(shutil.copytree(fibrous.result, tmp_path / "result"))], fibrous.dataset) as running:
        yield running


def opened(browser: Any, viewer: Viewer) -> tuple[Any, list[str]]:
    """Open the viewer and wait for its camera; return the page and what it complained about."""
    page = browser.new_page(viewport={"width": WIDE, "height": HIGH})
    complaints: list[str] = []
    page.on("console", lambda message: complaints.append(message.text) if message.type == "error" else None)
    page.on("request", lambda request: None if request.url.startswith(OWN) else complaints.append(request.url))
    page.set_default_timeout(PATIENCE_MS)
    known = set(viewer.served.server.get_clients())
    page.goto(viewer.served.address)
    page.add_style_tag(content="#webgl-software-rendering { display: none; }")  # a message that covers roots
    until(lambda: set(viewer.served.server.get_clients()) - known, "the browser's camera")
    return page, complaints


def click_root(page: Any, viewer: Viewer, number: int) -> None:
    """Click the middle of a root on the screen."""
    client = max(viewer.served.server.get_clients().items())[1]
    canvas = until(
        lambda: (box := page.evaluate(LARGEST)) and abs(box["width"] / box["height"] / client.camera.aspect - 1.0) < 0.02 and box
    )
    screen = screen_of(client)
    line = viewer.shown.session.state.lines[number]
    point = line.points_mm[3 * len(line.points_mm) // 4]
    seen = screen.camera_from_world[:3, :3] @ point + screen.camera_from_world[:3, 3]
    half = np.tan(screen.fov / 2.0) * seen[2]
    x = canvas["x"] + canvas["width"] * (0.5 + 0.5 * seen[0] / (half * screen.aspect))
    y = canvas["y"] + canvas["height"] * (0.5 + 0.5 * seen[1] / half)
    page.mouse.click(x, y)


def test_a_person_removes_debris_with_three_clicks_and_saves(browser: Any, viewer: Viewer, tmp_path: Path):
    page, complaints = opened(browser, viewer)
    page.get_by_role("tab", name="Edit").click()
    viewer.nodes()
    delete = page.get_by_role("button", name="Delete", exact=True)
    assert delete.is_disabled()
    click_root(page, viewer, 4)
    until(lambda: viewer.roots == [4], "the click to choose the fibre")
    page.get_by_text("Root 4", exact=True).wait_for()
    page.get_by_role("img", name="Diameter along the root").wait_for()
    picture = viewer.shown.pictures.files[viewer.shown.pictures.best_for(viewer.shown.session.state.lines[4], 1)[0]]
    page.get_by_role("img", name=picture).wait_for()  # the picture beside the 3D view follows the selection
    delete.click()
    until(lambda: 4 not in viewer.shown.session.state.lines, "the fibre to go")
    expected = float(plants.painted(plants.roots()).occupancy.sum(dtype=float)) * plants.VOXEL_MM**3
    assert viewer.shown.session.measure().volume_mm3 == pytest.approx(expected, rel=5e-3)
    page.get_by_text("1 correction", exact=True).wait_for()
    page.get_by_text("delete roots (4)").first.wait_for()
    page.get_by_role("button", name="Undo", exact=True).click()
    until(lambda: 4 in viewer.shown.session.state.lines, "the fibre to come back")
    page.get_by_role("button", name="Redo", exact=True).click()
    until(lambda: 4 not in viewer.shown.session.state.lines, "the fibre to go again")
    page.get_by_role("button", name="Save", exact=True).click()
    folder = viewer.shown.session.folder
    until((folder / log.LOG_NAME).is_file, "the log")
    summary = corrected.write(Session(folder), tmp_path / "corrected")
    assert summary["volume_mm3"] == pytest.approx(viewer.shown.session.measure().volume_mm3, rel=1e-9)
    page.keyboard.press("?")
    page.get_by_text("delete the selection").wait_for()
    assert not complaints
    page.close()


def test_the_picture_shows_roots_in_every_browser(browser: Any, viewer: Viewer):
    page, _ = opened(browser, viewer)

    def blue() -> float:
        box = page.evaluate(LARGEST)
        clip = {"x": box["x"], "y": box["y"] + 130, "width": box["width"], "height": box["height"] - 130}
        shot = cv2.imdecode(np.frombuffer(page.screenshot(clip=clip, timeout=PATIENCE_MS), np.uint8), cv2.IMREAD_COLOR)
        blue, green, red = (shot[..., k].astype(int) for k in range(3))
        return float(((blue - red > 60) & (green > 40)).mean())  # laterals are blue

    with_roots = until(lambda: blue() if blue() > 1e-3 else 0.0, "roots in the picture")
    page.get_by_role("tab", name="View").click()
    page.get_by_role("combobox", name="Colour by").click(timeout=60_000)
    page.get_by_role("option", name="uncertainty").click(timeout=60_000)
    until(lambda: viewer.look.colour == "uncertainty", "other colours")
    page.get_by_text("diameter ±0 %").wait_for()
    viewer.look.colour = "order"
    viewer.refresh()
    page.get_by_text("main root", exact=True).wait_for()
    assert page.get_by_label("Surface", exact=True).is_checked()
    other, _ = opened(browser, viewer)
    other.get_by_role("tab", name="View").click()
    other.get_by_label("Centre lines", exact=True).click()
    other.get_by_label("Surface", exact=True).click()
    until(lambda: not viewer.look.layers & {"surface", "centre lines"}, "roots to be switched off")
    other.close()
    page.bring_to_front()  # a page behind another one is not drawn
    until(lambda: not page.get_by_label("Surface", exact=True).is_checked(), "the first browser to follow")
    until(lambda: blue() < 0.3 * with_roots, "the picture to follow")
    page.close()


def test_views_screenshot_and_movie(browser: Any, viewer: Viewer):
    page, complaints = opened(browser, viewer)
    client = max(viewer.served.server.get_clients().items())[1]
    viewer.wait()
    page.get_by_text("Front", exact=True).click()
    front = viewer.scene.camera_position("Front", aspect=client.camera.aspect)
    until(lambda: np.allclose(client.camera.position, front, atol=0.1), "the view from the front")
    with page.expect_download(timeout=PATIENCE_MS) as waiting:
        page.get_by_role("button", name="Screenshot (PNG)").click()
    shot = Image.open(waiting.value.path())
    assert np.ptp(np.asarray(shot.convert("L"))) > 50
    movie = Image.open(io.BytesIO(capture.turntable(client, frames=3)))
    assert movie.n_frames == 3
    frames = [np.asarray(frame.convert("L")).astype(int) for frame in ImageSequence.Iterator(movie)]
    assert np.abs(frames[0] - frames[1]).max() > 50
    assert not complaints
    page.close()
