"""The commands that print and calibrate: what they accept, how they fail in one sentence, and the way from twin pictures to a scene."""

import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rhizotwin import cli, command_line
from rhizotwin.pages import PageOptions
from rhizotwin.scenes.atomic import write_image
from rhizotwin.scenes.board import CharucoBoard, load_board
from rhizotwin.scenes.files import load_scene

STAGE = re.compile(r"[a-z ]+: [0-9.]+ s")
"""The line that a finished stage leaves where no terminal shows a bar."""


def run(words: str) -> int:
    """Run a command line; return its exit code."""
    return cli.main(words.split())


def run_and_fail(words: str, capsys: pytest.CaptureFixture[str]) -> tuple[int, str]:
    """Run a command line that must fail; return its exit code and the one sentence it leaves on stderr."""
    code = run(words)
    lines = [line for line in capsys.readouterr().err.splitlines() if line.strip() and not STAGE.fullmatch(line)]
    assert len(lines) == 1, lines
    assert lines[0].startswith("rhizotwin: ")
    return code, lines[0]


def parsed(words: str) -> dict[str, Any]:
    """Return what a command line means."""
    bound = command_line.bind(words.split())[1]
    bound.apply_defaults()
    return bound.arguments


def test_defaults_and_forms_of_the_options() -> None:
    options = parsed("markers printed_8ml -o strip.pdf")
    assert (options["page"], options["paper_mm"]) == (PageOptions(), 0.1)
    page = PageOptions()
    assert (page.page, page.landscape, page.portrait, page.printed_ruler_mm) == ("a4", False, False, (100.0, 100.0))
    page = parsed("markers s -o f.svg --page 520X210 --portrait --printed-ruler-mm 99.6")["page"]
    assert (page.page, page.portrait, page.printed_ruler_mm) == ((520.0, 210.0), True, (99.6, 99.6))
    assert (page.paper().size_mm, page.paper().turn) == ((520.0, 210.0), "portrait")
    assert PageOptions().paper().turn == "either"
    assert PageOptions(page=(520.0, 210.0)).paper().turn == "as given"
    assert parsed("calibrate board -o f.svg --printed-ruler-mm 99.6x100.2")["page"].printed_ruler_mm == (99.6, 100.2)
    options = parsed("calibrate simulate s -o p --squares 9x6 --pictures 12")
    assert (options["drawn"].squares, options["taken"].pictures, options["taken"].seed, options["drawn"].square_mm) == ((9, 6), 12, 0, None)


@dataclass(frozen=True)
class Mistake:
    """A command line that cannot be meant, and what the complaint must name."""

    words: str
    named: str


MISTAKES = [
    Mistake("markers", "SCENE"),
    Mistake("markers printed_8ml", "-o"),
    Mistake("markers no_such_scene -o strip.pdf", "no_such_scene"),
    Mistake("markers printed_8ml -o strip.png", "strip.png"),
    Mistake("markers printed_8ml -o strip.pdf --page a9", "'a9' is no page"),
    Mistake("markers printed_8ml -o strip.pdf --page 297x", "'297x' is no page"),
    Mistake("markers printed_8ml -o strip.pdf --page 20x20", "50 to 5000"),
    Mistake("markers printed_8ml -o strip.pdf --page 160x80", "too small for the strip"),
    Mistake("markers printed_8ml -o strip.pdf --printed-ruler-mm 60", "90 to 110"),
    Mistake("markers printed_8ml -o strip.pdf --printed-ruler-mm ten", "'ten' is not what 100 mm became"),
    Mistake("markers printed_8ml -o strip.pdf --paper-mm 9", "0 to 2"),
    Mistake("markers printed_8ml -o strip.pdf --landscape --portrait", "--portrait"),
    Mistake("calibrate lens", "lens"),
    Mistake("calibrate board -o board.pdf --squares 7", "write it as 7x5"),
    Mistake("calibrate board -o board.pdf --squares 2x5", "3 to 60"),
    Mistake("calibrate board -o board.pdf --square-mm 60", "does not fit"),
    Mistake("calibrate board -o board.pdf --marker-mm 29", "marker_mm = 29.0: must be at most 27"),
    Mistake("calibrate board -o board.pdf --dictionary 9X9", "9X9"),
    Mistake("calibrate board -o board.pdf --squares 20x20 --square-mm 8", "needs 200 markers"),
    Mistake("calibrate camera no_such_folder -o lens", "no_such_folder"),
    Mistake("calibrate camera pictures -o lens --board no_such.toml", "no_such.toml"),
    Mistake("calibrate camera pictures -o lens --board b.toml --squares 9x6", "leave --squares out"),
    Mistake("calibrate camera pictures -o lens --scene no_such_scene", "no_such_scene"),
    Mistake("calibrate camera pictures -o lens", "none of the 3 pictures can be used"),
    Mistake("calibrate simulate printed_8ml -o pictures", "not empty"),
    Mistake("calibrate simulate printed_8ml -o twin --pictures 1", "give 3 to 1000"),
    Mistake("calibrate simulate printed_8ml -o twin --profile foggy", "foggy"),
    Mistake("calibrate simulate printed_8ml -o twin --square-mm 500", "too large for the camera"),
]


@pytest.mark.parametrize("mistake", MISTAKES, ids=lambda mistake: mistake.words)
def test_a_mistake_is_one_sentence_and_writes_nothing(
    mistake: Mistake, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    for k in range(3):
        write_image(tmp_path / "pictures" / f"{k}.png", np.full((300, 400), 100, np.uint8))
    code, said = run_and_fail(mistake.words, capsys)
    assert code == 2
    assert mistake.named in said
    assert [path.name for path in tmp_path.iterdir()] == ["pictures"]


def test_the_strip_and_the_board_are_written_and_nothing_is_overwritten(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run("markers printed_8ml -o strip.pdf") == 0
    assert "159.2 mm across" in capsys.readouterr().out
    assert run("calibrate board -o board.svg --squares 6x5 --square-mm 25") == 0
    assert load_board(tmp_path / "board.toml") == CharucoBoard(squares_xy=(6, 5), square_mm=25.0, marker_mm=18.333)
    capsys.readouterr()
    assert "strip.pdf exists already" in run_and_fail("markers printed_8ml -o strip.pdf", capsys)[1]
    assert "board.toml exists already" in run_and_fail("calibrate board -o board.pdf", capsys)[1]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["board.svg", "board.toml", "strip.pdf"]


def test_from_twin_pictures_to_a_scene_with_their_lens(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run("scenes sphere_20mm -o mine.toml") == 0
    assert run("calibrate simulate mine.toml -o twin --profile bench --pictures 10 --seed 1 --image-wh 400x300 --device cpu") == 0
    pictures = {f"board_{k:03d}.png" for k in range(10)}
    assert {path.name for path in (tmp_path / "twin").iterdir()} == {*pictures, "board.toml", "truth"}
    (tmp_path / "twin" / "view.png").write_bytes(b"not a picture")
    capsys.readouterr()
    assert run("calibrate camera twin -o lens") == 0
    said = capsys.readouterr().out
    assert "left out view.png: " in said
    assert "in 10 of 11 pictures" in said
    assert sorted(path.name for path in (tmp_path / "lens").iterdir()) == ["calibration.json", "camera.toml", "report.html"]
    true = json.loads((tmp_path / "twin" / "truth" / "camera.json").read_text(encoding="utf-8"))["camera"]
    found = load_scene(tmp_path / "lens" / "camera.toml").camera
    np.testing.assert_allclose(found.focal_px, true["focal_px"], rtol=1e-3)

    assert "its camera takes pictures of 800x600 px" in run_and_fail("calibrate camera twin -o two --scene mine.toml", capsys)[1]
    text = (tmp_path / "mine.toml").read_text(encoding="utf-8")
    (tmp_path / "mine.toml").write_text(text.replace("image_wh = [800, 600]", "image_wh = [400, 300]"), encoding="utf-8")
    assert run("calibrate camera twin -o two --scene mine.toml") == 0
    again = load_scene(tmp_path / "two" / "scene.toml").camera
    np.testing.assert_allclose(again.focal_px, found.focal_px, rtol=1e-9)  # OpenCV's threads add up in any order
    assert (again.image_wh, again.bits) == ((400, 300), 12)
    assert "lens: exists already" in run_and_fail("calibrate camera twin -o lens", capsys)[1].replace(str(tmp_path) + "/", "")
