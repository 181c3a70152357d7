"""The rig's commands as a person types them, on the twin's sketches."""

import io
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from rhizotwin.commands import cli
from rhizotwin.rig.rig_file import load_rig
from rhizotwin.scenes.dataset import load_dataset
from rhizotwin.scenes.files import load_scene, save_scene
from tests.command import Command
from tests.rhizotwin.timelapse.conftest import small_scene

ROOT = Path(__file__).resolve().parents[2]
SKETCH = ("--fidelity", "sketch", "--profile", "clean", "--seed", "2")


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    """Return the file of a small scene."""
    save_scene(small_scene(3), tmp_path / "scene.toml")
    return tmp_path / "scene.toml"


def test_scan_of_the_twin(scene: Path, tmp_path: Path, command: Command) -> None:
    record, words = tmp_path / "wire.jsonl", ("scan", "--rig", "twin", "--scene", scene, "-o", tmp_path / "d", *SKETCH)
    command.fails(*words, "--record", scene, named=["is not a recording"])
    assert load_scene(scene)
    assert "wrote 3 pictures to" in command.works(*words, "--record", record).out
    dataset = load_dataset(tmp_path / "d")
    assert dataset.origin["complete"]
    assert dataset.seed == 2
    wire = [json.loads(line) for line in record.read_text().splitlines()]
    assert {entry.get("device") for entry in wire} == {None, "turntable", "arm"}
    command.fails(*words, named=["contains a finished scan; choose a new folder"])
    assert "all 3 pictures exist" in command.works(*words, "--resume").out
    assert load_dataset(tmp_path / "d").frames == dataset.frames


def test_check_of_the_twin_and_of_a_rig_that_is_not_there(scene: Path, tmp_path: Path, command: Command) -> None:
    assert command.works("rig", "check", "twin", "--scene", scene, "--profile", "clean").out.startswith("turntable  ok")
    command.works("rig", "example", "-o", tmp_path / "rig.toml")
    assert load_rig(tmp_path / "rig.toml").name == "my_rig"
    command.fails("rig", "example", "-o", tmp_path / "rig.toml", named=["already exists"])
    (tmp_path / "rig.toml").write_text('[turntable]\nport = "/dev/no-table"\n[camera]\nkind = "v4l2"\naddress = "/dev/no-camera"\n')
    told = command.fails("rig", "check", tmp_path / "rig.toml", named=["2 checks of rig failed"]).out
    assert "turntable  WRONG /dev/no-table does not exist" in told
    assert "camera     WRONG" in told


def test_jog_from_a_pipe(scene: Path, command: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    words = ("rig", "jog", "twin", "--scene", scene, "--profile", "clean")
    monkeypatch.setattr(sys, "stdin", io.StringIO("home 0\ntable +9\npose\nquit\n"))
    assert "table at 9.000 deg" in command.works(*words).out
    monkeypatch.setattr(sys, "stdin", io.StringIO("table sideways\nhome 0\n"))
    assert "table at" not in command.fails(*words, named=["'table sideways' is invalid; usage: table +9"]).out


@pytest.mark.parametrize("number", [signal.SIGHUP, signal.SIGKILL], ids=lambda number: number.name)
def test_a_stopped_scan_is_finished(number: signal.Signals, scene: Path, tmp_path: Path, command: Command) -> None:
    (tmp_path / "plan.toml").write_text("[[plan.rings]]\nviews = 12\nheight_mm = -20.0\n")
    words = ["scan", "--rig", "twin", "--scene", scene, "--plan", tmp_path / "plan.toml", "-o", tmp_path / "d", *SKETCH]
    program = [sys.executable, "-m", "rhizotwin", *map(str, words)]
    running = subprocess.Popen(program, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    until, third = time.monotonic() + 60.0, tmp_path / "d" / "images" / "view_002.png"
    while not third.exists() and running.poll() is None and time.monotonic() < until:
        os.sched_yield()
    running.send_signal(number)
    said, _ = running.communicate(timeout=60)
    assert running.returncode == (-signal.SIGKILL if number == signal.SIGKILL else cli.EXIT_STOPPED), said
    if number != signal.SIGKILL:
        assert "the same command with --resume to continue" in said
        assert "Traceback" not in said
    before = load_dataset(tmp_path / "d")
    assert not before.origin["complete"]
    kept = {frame.file: frame for frame in before.frames if (tmp_path / "d" / frame.file).is_file()}
    assert 2 <= len(kept) < 12
    command.works(*words, "--resume")
    after = load_dataset(tmp_path / "d")
    assert len(after.frames) == 12
    assert all(kept.get(frame.file, frame) == frame for frame in after.frames)
    assert not [path for path in (tmp_path / "d").rglob("*") if path.name.endswith(".tmp")]
