"""Several results in one viewer."""

import json
import shutil
from pathlib import Path

import pytest
import viser

from rhizotwin.viewer import app, words
from tests.rhizotwin import plant as plants


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
