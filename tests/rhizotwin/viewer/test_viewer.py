"""Selection, corrections, messages, views and several results of the viewer, without a browser."""

import shutil
import time
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest

from rhizotwin.corrections import log
from rhizotwin.scenes.errors import UserError
from rhizotwin.viewer import capture
from rhizotwin.viewer.app import Viewer
from tests.rhizotwin import plant as plants
from tests.rhizotwin.browser import until
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
    viewer.correct("delete roots", roots=[2])
    monkeypatch.setattr(log, "write", full)
    viewer.save()
    assert viewer.message == "the corrections could not be saved: the disk is full"
    assert viewer.unsaved() == 1


def test_an_error_of_a_thread_is_shown_and_the_rest_goes_on(viewer: Viewer, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(Viewer, "_draw_surface", Mock(side_effect=SystemExit("killed")))
    viewer.refresh()
    until(lambda: "an unexpected error occurred (SystemExit: killed)" in viewer.message)
    monkeypatch.undo()
    viewer.served.server._thread_executor.submit(lambda: 1 / 0).result()  # as viser calls the handlers of clicks
    assert viewer.message.endswith("the traceback is in the terminal in which 'rhizotwin view' runs")
    viewer.look.layers ^= {"surface"}
    viewer.refresh()
    viewer.wait()
    assert viewer._keys["edits of surface"] is None


def test_a_turntable_camera_keeps_its_height_and_distance():
    position, centre = np.array([100.0, 0.0, 20.0]), np.array([1.0, 2.0, -30.0])
    frames = list(capture.orbit(np.array([1.0, 0.0, 0.0, 0.0]), position, centre, 8))
    distances = [np.linalg.norm(at[:2] - centre[:2]) for _, at in frames]
    assert distances == pytest.approx([distances[0]] * 8)
    assert [at[2] for _, at in frames] == pytest.approx([20.0] * 8)
    assert frames[4][1][:2] == pytest.approx(2.0 * centre[:2] - position[:2])


def inputs(running: Viewer) -> dict[str, Any]:
    """Return the controls of the panel by their labels."""
    return {getattr(one, "label", ""): one for one in running.served.server.gui._gui_input_handle_from_uuid.values()}


def test_a_result_that_cannot_be_shown_leaves_the_earlier_one(plant: plants.Plant, tmp_path: Path):
    other = Path(shutil.copytree(plant.result, tmp_path / "day 2"))
    data = (other / "shape.npz").read_bytes()
    (other / "shape.npz").write_bytes(data.replace(b"PK", b""))
    with started([plant.result, other], plant.dataset) as running:
        slider = inputs(running)["Result"]
        slider.value = 2
        running.refresh()
        assert (running.shown.name, slider.value) == (plant.result.name, 1)
        assert str(other) in running.message
        running.load(0)
        assert running.message == ""


def test_each_result_has_its_own_pictures_and_layers(plant: plants.Plant, tmp_path: Path):
    moved = Path(shutil.copytree(plant.result, tmp_path / "moved")) / "result.json"
    moved.write_text(moved.read_text().replace(str(plant.dataset), str(tmp_path / "nowhere")))
    with started([moved.parent, plant.result], None) as running:
        shown = [inputs(running)[name] for name in ("Canister", "Cameras", "Surface")]
        assert [one.visible for one in shown] == [False, False, True]
        running.load(1)
        assert [one.visible for one in shown] == [True, True, True]
