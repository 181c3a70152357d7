"""State of a running scan, the sketch of its roots, and the measurements of a picture."""

from pathlib import Path

import numpy as np
import pytest

from rhizotwin.console.live import Live
from rhizotwin.console.pictures import PICTURE_PX, show
from rhizotwin.console.sketch import Sketch
from rhizotwin.rig.scanning.observer import Look
from rhizotwin.rig.scanning.preflight import Exposure
from rhizotwin.scenes.dataset import Frame, load_dataset, read_image
from rhizotwin.scenes.model import Scene
from tests.rhizotwin import plant as plants


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
    assert len(sketch.carve()[0]) == 0  # two pictures give no shape


def test_pause_and_stop():
    changes: list[None] = []
    live = Live(Scene(), on_change=lambda: changes.append(None), paused=True)
    live.on_plan(40, 10)
    assert (live.done, live.total) == (10, 40)
    assert live.holds()
    live.pause(paused=False)
    assert not live.holds()
    assert live.left_s() is None
    for number in (10, 11):
        frame = Frame(file=f"images/view_{number:03d}.png", sha256="")
        image = np.zeros((3, 4), np.uint8)
        live.on_look(Look(frame=frame, image=image, exposure=Exposure(bright=0.5, saturated=0.0), sighting=None, motion=None))
    assert live.done == 12
    assert live.left_s() >= 0.0
    live.on_drop(["images/view_011.png"])
    assert live.done == 11
    live.stop()
    with pytest.raises(KeyboardInterrupt):
        live.holds()
    live.close()
    assert live.ended
    assert len(changes) > 5


def test_an_error_of_the_console_does_not_reach_the_scan():
    def broken() -> None:
        raise ValueError

    live = Live(Scene(), on_change=broken)
    live.on_plan(3, 0)
    live.close()


def test_measurements_of_a_picture():
    dark = np.full((300, 1000), 20, np.uint8)
    shown = show(dark, None, number=3, title="dark", panel=(0.1, 0.4), motion=0.02)
    found = {meter.name: meter for meter in shown.meters}
    assert found["Exposure"].state == "bad"
    assert found["Exposure"].value.startswith("8 % of full scale")
    assert found["Panel"].state == "fair"
    assert found["Motion"].value == "2.0 % of the picture still moves"
    assert "Focus" not in found
    assert shown.jpeg.startswith(b"\xff\xd8")
    import cv2

    assert cv2.imdecode(np.frombuffer(shown.jpeg, np.uint8), cv2.IMREAD_COLOR).shape[1] == PICTURE_PX
