"""The command line: what it accepts, and how every failure ends: one sentence, an exit code, no traceback."""

import errno
import inspect
import re
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rhizotwin.commands import COMMANDS, GROUPS, cli, command_line, place
from rhizotwin.commands.page_options import PageOptions
from rhizotwin.scenes import files
from rhizotwin.scenes.atomic import write_image
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.specimens import MeshSpecimen, RsmlSpecimen
from rhizotwin.steps.arguments import SceneChanges
from rhizotwin.steps.scene_changes import change_scene
from tests.command import Command


def test_help_teaches(command: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every help has a usage, an example and a word on each option; the table of commands has the first line of each."""
    monkeypatch.setenv("COLUMNS", "160")
    poor = []
    for name in ("", *COMMANDS):
        help_text = command.works(f"{name} --help").out
        if f"Usage: rhizotwin {name}".rstrip() not in help_text or "None" in help_text:
            poor.append(f"{name}: usage or a default")
        if not re.search(rf"^  (  )?rhizotwin {name}".rstrip(), help_text, re.MULTILINE):
            poor.append(f"{name}: no example")
        options = re.findall(r"^│ [* ] +(--[a-z-]+.*?)│$", help_text, re.MULTILINE)
        poor += [f"{name}: {option.strip()} is not explained" for option in options if not re.search(r"  \w", option)]
    for name, line in COMMANDS.items():
        module, _, function = place(name).partition(":")
        source = import_module(module) if name in GROUPS else getattr(import_module(module), function)
        if (inspect.getdoc(source) or "").splitlines()[0] != line:
            poor.append(f"{name}: another first line than in COMMANDS")
    assert poor == []


def test_help_of_groups_and_completion_in_shells(command: Command) -> None:
    assert "reconstruct" in command.works().out
    assert "jog" in command.works("rig").out
    app = command_line.build()
    scripts = {shell: app.generate_completion(shell=shell) for shell in ("bash", "zsh", "fish")}
    words = ("reconstruct", "voxel-mm", "calibrate", "printed-ruler-mm", "backlit")
    assert [(shell, word) for shell, script in scripts.items() for word in words if word not in script] == []


def given(words: str) -> dict[str, Any]:
    """Return what a command line gives to its function."""
    bound = command_line.bind(words.split())[1]
    bound.apply_defaults()
    return bound.arguments


def test_defaults_and_forms_of_the_options() -> None:
    assert given("reconstruct d -o r --voxel-mm 0.1")["settings"].voxel_mm == 0.1
    assert given("simulate s -o d --image-wh 800X600")["changes"].image_wh == (800, 600)
    page = given("markers s -o f.svg --page 520X210 --portrait --printed-ruler-mm 99.6")["page"]
    assert (page.page, page.portrait, page.printed_ruler_mm) == ((520.0, 210.0), True, (99.6, 99.6))
    assert (page.paper().size_mm, page.paper().turn) == ((520.0, 210.0), "portrait")
    assert PageOptions(page=(520.0, 210.0)).paper().turn == "as given"
    assert given("calibrate board -o f.svg --printed-ruler-mm 99.6x100.2")["page"].printed_ruler_mm == (99.6, 100.2)


MISTAKES = [
    ("simulat sphere_20mm", "simulat"),
    ("simulate spere_20mm -o d", 'did you mean "sphere_20mm"'),
    ("simulate sphere_20mm -o d --views 0", "--views"),
    ("simulate sphere_20mm -o d --image-wh 8x6", "16 to 20000"),
    ("simulate sphere_20mm -o d --specimen no_such.stl --specimen-unit cm", "--specimen-unit applies to traced roots only"),
    ("reconstruct no_such_dataset -o r", "no_such_dataset: there is no such folder"),
    ("reconstruct d -o r --voxel-mm nan", "0.01 to 10 mm"),
    ("import pictures --masks --scene sphere_20mm -o d", "--cameras JSON"),
    ("score no_such_result --truth a.stl --volume-ml 8", "exactly one reference"),
    ("score no_such_result --volume-ml 0", "--volume-ml"),
    ("scenes sphere_20mm --specimen-stl a.obj", ".stl"),
    (f"plan sphere_20mm -o d --views {100_000 * '['}", "too many nested brackets"),
    ("plan sphere_20mm -o d --heights=-42,x", "not a number of mm"),
    ("plan sphere_20mm -o pictures", "were not written by an earlier plan"),
    ("markers printed_8ml -o strip.pdf --page a9", "'a9' is not a paper size"),
    ("markers printed_8ml -o strip.pdf --printed-ruler-mm 60", "90 to 110"),
    ("markers printed_8ml -o strip.pdf --landscape --portrait", "--portrait"),
    ("calibrate board -o board.pdf --squares 7", "write it as 7x5"),
    ("calibrate board -o board.pdf --marker-mm 29", "marker_mm = 29.0: must be at most 27"),
    ("calibrate camera pictures -o lens --board no_such.toml", "no_such.toml"),
    ("calibrate camera pictures -o lens", "none of the 3 pictures can be used"),
    ("calibrate simulate printed_8ml -o pictures", "not empty"),
    ("calibrate simulate printed_8ml -o twin --pictures 1", "give 3 to 1000"),
    ("scan --rig twin -o d --table-angle 400", "-360 to 360"),
    ("scan --rig no_such_rig.toml -o d", "there is no rig file no_such_rig.toml"),
    ("camera no_such_rig.toml --port 70000", "1 to 65535"),
]


@pytest.mark.parametrize(("words", "named"), MISTAKES, ids=[words[:80] for words, _ in MISTAKES])
def test_a_mistake_is_one_sentence_and_writes_nothing(words: str, named: str, tmp_path: Path, monkeypatch, command: Command) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "80")
    for k in range(3):
        write_image(tmp_path / "pictures" / f"{k}.png", np.full((300, 400), 100, np.uint8))
    command.fails(words, named=[named])
    assert [path.name for path in tmp_path.iterdir()] == ["pictures"]
    assert len(list((tmp_path / "pictures").iterdir())) == 3


FAILURES = [
    (UserError("views/a.png is\ncut short; copy it again"), 2, "views/a.png is cut short; copy it again"),
    (KeyboardInterrupt(), 130, "interrupted; nothing was written"),
    (OSError(errno.ENOSPC, "No space left on device", "out/a.png"), 2, "out/a.png: the disk is full; free some space"),
    (PermissionError(errno.EACCES, "Permission denied", "out"), 1, "out: Permission denied"),
    (MemoryError(), 1, "not enough memory"),
    (ValueError("shapes\ndiffer"), 1, "unexpected error (ValueError: shapes differ); run the command again with RHIZOTWIN_DEBUG=1"),
]


@pytest.mark.parametrize(("error", "code", "sentence"), FAILURES, ids=lambda value: type(value).__name__)
def test_failure_inside_a_command(error: BaseException, code: int, sentence: str, monkeypatch, command: Command) -> None:
    def fail() -> None:
        raise error

    monkeypatch.setattr("rhizotwin.commands.scenes.scenes", fail)
    monkeypatch.delenv(cli.DEBUG_VARIABLE, raising=False)
    done = command("scenes")
    assert (done.code, done.err) == (code, f"{done.sentence}\n")
    assert sentence in done.sentence
    monkeypatch.setenv(cli.DEBUG_VARIABLE, "1")
    assert "Traceback" in command("scenes").err


def test_scenes_are_listed_and_copied(tmp_path: Path, command: Command) -> None:
    listed = [line.split()[0] for line in command.works("scenes").out.splitlines() if line.strip()]
    known = ("sphere_20mm", "printed_8ml", "radish_day05a", "radish_day30c", "fallen_plant", "clean", "bench", "harsh")
    assert [listed.count(name) for name in known] == [1] * len(known)
    path = tmp_path / "mine.toml"
    command.works("scenes", "printed_8ml", "-o", path)
    assert files.load_scene(path) == files.load_scene("printed_8ml")
    command.fails("scenes", "printed_8ml", "-o", path, named=["already exists"])


def test_options_change_the_scene(tmp_path: Path) -> None:
    scene = files.load_scene("sphere_20mm")
    changed = change_scene(scene, SceneChanges(views=7, image_wh=(400, 300), profile="bench"))
    assert [ring.views for ring in changed.plan.rings] == [7] * len(scene.plan.rings)
    assert changed.camera.image_wh == (400, 300)
    assert changed.camera.focal_px[0] == pytest.approx(scene.camera.focal_px[0] * 400 / scene.camera.image_wh[0])
    assert changed.disturbances == files.load_profile("bench")
    assert change_scene(scene, SceneChanges()) == scene
    mesh, file = tmp_path / "a.STL", tmp_path / "a.rsml"
    mesh.touch()
    file.touch()
    assert isinstance(change_scene(scene, SceneChanges(specimen=mesh)).specimen, MeshSpecimen)
    assert change_scene(scene, SceneChanges(specimen=file, specimen_unit="cm", specimen_diameter_mm=0.5)).specimen == RsmlSpecimen(
        file=str(file), unit="cm", diameter_mm=0.5
    )


def test_demo_never_overwrites_what_is_no_demo(tmp_path: Path, command: Command) -> None:
    (tmp_path / "dataset").mkdir()
    (tmp_path / "dataset" / "mine.png").touch()
    command.fails("demo", "-o", tmp_path, named=["not written by the demo"])
    assert (tmp_path / "dataset" / "mine.png").exists()
