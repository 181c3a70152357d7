"""A scan watched in a browser: paused, gone on with, measured; and the sketch of the roots."""

import threading
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rhizotwin.rig.open import open_devices
from rhizotwin.rig.scanning.observer import Look
from rhizotwin.rig.scanning.observers import Observers
from rhizotwin.rig.scanning.preflight import Exposure
from rhizotwin.rig.scanning.scan import scan
from rhizotwin.rig.twin.twin import Twin
from rhizotwin.scenes.dataset import load_dataset, read_image
from rhizotwin.scenes.files import load_profile
from rhizotwin.scenes.model import Camera, CapturePlan, MarkerStrip, Ring, Scene
from rhizotwin.viewer import live_page
from rhizotwin.viewer.live import Live
from rhizotwin.viewer.sketch import Sketch
from tests.rhizotwin import plant as plants
from tests.rhizotwin.browser import PATIENCE_MS, wait

SCENE = Scene(
    camera=Camera().resized((400, 300)),
    strip=MarkerStrip(columns=22, rows=1, marker_mm=18.0, bottom_mm=2.0),
    plan=CapturePlan(rings=(Ring(views=4, height_mm=-20.0),)),
    disturbances=load_profile("bench"),
)


def test_the_sketch_holds_every_root_and_little_else(tmp_path: Path):
    made = plants.make(tmp_path)
    dataset = load_dataset(made.dataset)
    sketch = Sketch(dataset.scene)
    assert sketch.evenness(0) is None
    for frame in dataset.frames:
        sketch.add(frame.file, 0, read_image(dataset, frame), np.array(frame.cam_from_canister))
    cells, edge_mm = sketch.carve()
    points = np.concatenate([root.points_mm for root in made.roots])
    away = np.abs(points[:, None] - cells[None]).max(axis=-1).min(axis=1)
    assert np.mean(away <= 0.5 * edge_mm + 1e-9) > 0.95
    far = np.linalg.norm(cells[:, None] - points[None], axis=-1).min(axis=1)
    assert far.max() < 10.0  # mm: eight views of 200 pixels leave a little round each root
    assert sketch.evenness(0) == pytest.approx((230 / 255, 230 / 255))
    for frame in dataset.frames[:6]:
        sketch.drop(frame.file)
    assert len(sketch.carve()[0]) == 0  # two pictures tell nothing


def test_what_the_page_says():
    live = Live(SCENE)
    live.on_plan(40, 10)
    assert "10 of 40" in live_page.head(live)
    live.pause(paused=True)
    assert "Paused" in live_page.head(live)
    assert live.holds()
    live.pause(paused=False)
    assert not live.holds()
    live.stop()
    assert "Stopping" in live_page.head(live)
    with pytest.raises(KeyboardInterrupt):
        live.holds()
    dark = Look(frame=None, image=np.zeros((3, 4), np.uint8), exposure=Exposure(bright=0.1, saturated=0.0), sighting=None, motion=0.02)
    said = live_page.meters(dark, (0.1, 0.4))
    assert "bad; at least 20 %" in said
    assert "darkest part 25 % of the brightest" in said
    assert "2.0 % of the picture moving" in said
    assert live_page.duration(89.0) == "89 s"
    assert live_page.duration(600.0) == "10 min"
    live.close()


@pytest.mark.slow
def test_a_person_watches_a_scan_of_the_twin(browser: Any, tmp_path: Path):
    twin = Twin(SCENE, seed=1, profile_name="bench", pictures="sketch")
    live = Live(twin.calibrated_scene(), paused=True)
    served = live_page.serve(live, port=8290)
    devices = open_devices(twin.rig, twin.calibrated_scene(), clock=twin.clock, camera=twin.open_camera())
    scanned = threading.Thread(
        target=lambda: scan(devices, twin.calibrated_scene(), tmp_path / "d", observers=Observers(say=lambda _: None, observer=live)),
        daemon=True,
    )
    try:
        page = browser.new_page(viewport={"width": 640, "height": 400})
        page.set_default_timeout(PATIENCE_MS)
        page.goto(served.address)
        scanned.start()
        page.get_by_text("Paused:").wait_for()
        page.get_by_text("0 of 4 pictures").wait_for()
        page.get_by_role("button", name="Continue").click()
        wait(lambda: live.done == 4, "the pictures")
        page.get_by_text("4 of 4 pictures").wait_for()
        page.get_by_text("Focus", exact=True).wait_for()
        page.get_by_text("Exposure", exact=True).wait_for()
        page.get_by_text("Motion after stop", exact=True).wait_for()
        source = page.locator("img").first.get_attribute("src")
        assert source is not None
        assert source.startswith(("blob:", "data:"))
        page.close()
        scanned.join(PATIENCE_MS / 1000.0)
        live.close()
    finally:
        devices.close()
        served.stop()
    assert load_dataset(tmp_path / "d").origin["complete"]
    assert all(look.sighting is not None for look in live.looks)
    assert live.panel is not None


def test_only_the_last_picture_is_kept_large():
    live = Live(SCENE)
    look = Look(frame=None, image=np.zeros((300, 400), np.uint8), exposure=Exposure(bright=0.5, saturated=0.0), sighting=None, motion=None)
    for _ in range(3):
        live.on_look(replace(look))
    assert [one.image.shape[1] < 400 for one in live.looks] == [True, True, False]
    live.close()
