"""The commands that print and calibrate: the strip, the board, and the way from twin pictures to a scene with their lens."""

import json
from pathlib import Path

import numpy as np
import pytest

from rhizotwin.scenes.board import CharucoBoard, load_board
from rhizotwin.scenes.files import load_scene
from tests.command import Command


def test_strip_and_board_are_written_and_never_overwritten(tmp_path: Path, monkeypatch, command: Command) -> None:
    monkeypatch.chdir(tmp_path)
    assert "must be 159.2 mm" in command.works("markers printed_8ml -o strip.pdf").out
    command.works("calibrate board -o board.svg --squares 6x5 --square-mm 25")
    assert load_board(tmp_path / "board.toml") == CharucoBoard(squares_xy=(6, 5), square_mm=25.0, marker_mm=18.333)
    command.fails("markers printed_8ml -o strip.pdf", named=["strip.pdf already exists"])
    command.fails("calibrate board -o board.pdf", named=["board.toml already exists"])
    assert sorted(path.name for path in tmp_path.iterdir()) == ["board.svg", "board.toml", "strip.pdf"]


def test_from_twin_pictures_to_a_scene_with_their_lens(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: Command) -> None:
    monkeypatch.chdir(tmp_path)
    command.works("scenes sphere_20mm -o mine.toml")
    command.works("calibrate simulate mine.toml -o twin --profile bench --pictures 10 --seed 1 --image-wh 400x300 --device cpu")
    pictures = {f"board_{k:03d}.png" for k in range(10)}
    assert {path.name for path in (tmp_path / "twin").iterdir()} == {*pictures, "board.toml", "truth"}
    (tmp_path / "twin" / "view.png").write_bytes(b"not a picture")
    told = command.works("calibrate camera twin -o lens").out
    assert "excluded picture: view.png: " in told
    assert "in 10 of 11 pictures" in told
    assert sorted(path.name for path in (tmp_path / "lens").iterdir()) == ["calibration.json", "camera.toml", "report.html"]
    true = json.loads((tmp_path / "twin" / "truth" / "camera.json").read_text(encoding="utf-8"))["camera"]
    found = load_scene(tmp_path / "lens" / "camera.toml").camera
    np.testing.assert_allclose(found.focal_px, true["focal_px"], rtol=1e-3)

    command.fails("calibrate camera twin -o two --scene mine.toml", named=["has 800x600 pixels"])
    text = (tmp_path / "mine.toml").read_text(encoding="utf-8")
    text = text.replace("image_wh = [800, 600]", "image_wh = [400, 300]").replace('\ntransfer = "linear"', '\ntransfer = "srgb"')
    (tmp_path / "mine.toml").write_text(text, encoding="utf-8")
    command.works("calibrate camera twin -o two --scene mine.toml")
    again = load_scene(tmp_path / "two" / "scene.toml").camera
    np.testing.assert_allclose(again.focal_px, found.focal_px, rtol=1e-9)  # OpenCV's threads add up in any order
    assert (again.image_wh, again.bits, again.transfer) == ((400, 300), 12, "srgb")
    command.fails("calibrate camera twin -o lens", named=["lens: the folder already exists and is not empty"])
