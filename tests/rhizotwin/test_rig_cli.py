"""The rig's commands as a person types them, on the twin's sketches."""

import io
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import pytest

from rhizotwin import cli
from rhizotwin.rig.rig_file import load_rig
from rhizotwin.scenes.dataset import load_dataset
from rhizotwin.scenes.files import load_scene, save_scene
from rhizotwin.scenes.model import Camera, CapturePlan, MarkerStrip, Ring, Scene

ROOT = Path(__file__).resolve().parents[2]
SKETCH = ("--fidelity", "sketch", "--profile", "clean", "--seed", "2")


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    """Return the file of a small scene."""
    small = Scene(
        camera=Camera().resized((400, 300)),
        strip=MarkerStrip(columns=22, rows=1, marker_mm=18.0, bottom_mm=2.0),
        plan=CapturePlan(rings=(Ring(views=3, height_mm=-20.0),)),
    )
    save_scene(small, tmp_path / "scene.toml")
    return tmp_path / "scene.toml"


def say(capsys: pytest.CaptureFixture[str], *words: object) -> tuple[int, str, str]:
    """Run a command line; return its exit code, what it printed, and the program's own line on stderr."""
    code = cli.main([str(word) for word in words])
    out, err = capsys.readouterr()
    own = [line for line in err.splitlines() if line.startswith("rhizotwin: ")]
    return code, out, own[-1] if own else ""


@dataclass(frozen=True)
class Mistake:
    """A command line that cannot be meant, and what the complaint must name."""

    words: str
    named: str


MISTAKES = [
    Mistake("scan -o d", "--rig"),
    Mistake("scan --rig twin", "-o"),
    Mistake("scan --rig twin -o d --table-angle north", "'north' is not a number"),
    Mistake("scan --rig twin -o d --table-angle 400", "-360 to 360"),
    Mistake("scan --rig twin -o d --seed -1", "--seed"),
    Mistake("scan --rig twin -o d --fidelity best", "best"),
    Mistake("scan --rig twin -o d --scene nothing", "nothing"),
    Mistake("scan --rig twin -o d --profile foggy --fidelity sketch", "foggy"),
    Mistake("scan --rig no_such_rig.toml -o d", "--scene is missing"),
    Mistake("scan --rig no_such_rig.toml --scene sphere_20mm -o d", "no_such_rig.toml"),
    Mistake("rig check", "RIG"),
    Mistake("rig check no_such_rig.toml", "no_such_rig.toml"),
    Mistake("rig polish", "polish"),
    Mistake("twin --speed 0", "0.01 to 1000"),
    Mistake("twin --protocol serial", "serial"),
    Mistake("camera", "RIG"),
    Mistake("camera no_such_rig.toml", "no_such_rig.toml"),
    Mistake("camera no_such_rig.toml --port 70000", "1 to 65535"),
]


@pytest.mark.parametrize("mistake", MISTAKES, ids=lambda mistake: mistake.words)
def test_a_mistake_is_one_sentence(mistake: Mistake, capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    code, _, sentence = say(capsys, *mistake.words.split())
    assert code == cli.EXIT_MISTAKE
    assert mistake.named in sentence
    assert not list(tmp_path.iterdir())


def test_scan_of_the_twin(scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    record = tmp_path / "wire.jsonl"
    code, out, _ = say(capsys, "scan", "--rig", "twin", "--scene", scene, "-o", tmp_path / "d", "--record", record, *SKETCH)
    assert code == 0
    assert "3 pictures in" in out
    dataset = load_dataset(tmp_path / "d")
    assert dataset.origin["complete"]
    assert dataset.seed == 2
    wire = [json.loads(line) for line in record.read_text().splitlines()]
    assert {entry.get("device") for entry in wire} == {None, "turntable", "arm"}
    code, _, sentence = say(capsys, "scan", "--rig", "twin", "--scene", scene, "-o", tmp_path / "d", *SKETCH)
    assert code == cli.EXIT_MISTAKE
    assert "holds a finished scan: choose a new folder" in sentence
    code, out, _ = say(capsys, "scan", "--rig", "twin", "--scene", scene, "-o", tmp_path / "d", "--resume", *SKETCH)
    assert code == 0
    assert "all 3 pictures are there" in out
    assert load_dataset(tmp_path / "d").frames == dataset.frames


def test_plan_of_another_file(scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "plan.toml").write_text("[[plan.rings]]\nviews = 2\nheight_mm = -20.0\n")
    (tmp_path / "none.toml").write_text('name = "none"\n')
    words = ["scan", "--rig", "twin", "--scene", scene, *SKETCH]
    assert say(capsys, *words, "-o", tmp_path / "d", "--plan", tmp_path / "plan.toml")[0] == 0
    assert len(load_dataset(tmp_path / "d").frames) == 2
    code, _, sentence = say(capsys, *words, "-o", tmp_path / "e", "--plan", tmp_path / "none.toml")
    assert code == cli.EXIT_MISTAKE
    assert "none.toml: has no [[plan.rings]]" in sentence
    code, _, sentence = say(capsys, *words, "-o", tmp_path / "d", "--resume")
    assert code == cli.EXIT_MISTAKE
    assert "begun with another scene.plan.rings.1.views" in sentence


def test_record_does_not_grow_into_another_file(scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, _, sentence = say(capsys, "scan", "--rig", "twin", "--scene", scene, "-o", tmp_path / "d", "--record", scene, *SKETCH)
    assert code == cli.EXIT_MISTAKE
    assert "holds no record" in sentence
    assert load_scene(scene)


def test_check_of_the_twin(scene: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = say(capsys, "rig", "check", "twin", "--scene", scene, "--profile", "clean")
    assert code == 0
    assert out.startswith("turntable  ok")


def test_check_of_a_rig_that_is_not_there(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "rig.toml").write_text('[turntable]\nport = "/dev/no-table"\n[camera]\nkind = "v4l2"\naddress = "/dev/no-camera"\n')
    code, out, sentence = say(capsys, "rig", "check", tmp_path / "rig.toml")
    assert code == cli.EXIT_MISTAKE
    assert "turntable  WRONG /dev/no-table is not there" in out
    assert "camera     WRONG" in out
    assert "2 things are wrong with rig" in sentence


def test_jog_from_a_pipe(scene: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdin", io.StringIO("home 0\ntable +9\npose\nquit\n"))
    code, out, _ = say(capsys, "rig", "jog", "twin", "--scene", scene, "--profile", "clean")
    assert code == 0
    assert "table at 9.000 deg" in out
    monkeypatch.setattr(sys, "stdin", io.StringIO("table sideways\nhome 0\n"))
    code, out, sentence = say(capsys, "rig", "jog", "twin", "--scene", scene, "--profile", "clean")
    assert code == cli.EXIT_MISTAKE
    assert "'table sideways' is not understood" in sentence
    assert "table at" not in out


def test_example_is_written_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "rig.toml"
    assert say(capsys, "rig", "example", "-o", path)[0] == 0
    assert load_rig(path).name == "my_rig"
    code, _, sentence = say(capsys, "rig", "example", "-o", path)
    assert code == cli.EXIT_MISTAKE
    assert "exists already" in sentence


def test_the_rig_loads_without_what_a_small_computer_does_not_have() -> None:
    """Neither the rig nor its command line needs Mitsuba, meshes or plots until the twin renders."""
    heavy = ("mitsuba", "drjit", "trimesh", "skimage", "matplotlib", "manifold3d")
    program = (
        "import sys; from rhizotwin.commands import scan, rig, camera, twin; from rhizotwin.rig import jog, bench, open; "
        "from rhizotwin.rig.scanning import scan; "
        f"print([name for name in {heavy} if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=True, timeout=120)
    assert done.stdout.strip() == "[]"


def started(words: Sequence[object]) -> "subprocess.Popen[str]":
    command = [sys.executable, "-m", "rhizotwin", *map(str, words)]
    return subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)


def wait_for(path: Path, running: "subprocess.Popen[str]") -> None:
    """Wait until a file is there, or the program has ended."""
    until = time.monotonic() + 60.0
    while not path.exists() and running.poll() is None and time.monotonic() < until:
        os.sched_yield()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGHUP, signal.SIGKILL], ids=lambda number: number.name)
def test_a_stopped_scan_is_finished(number: signal.Signals, scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "plan.toml").write_text("[[plan.rings]]\nviews = 60\nheight_mm = -20.0\n")
    words = ["scan", "--rig", "twin", "--scene", scene, "--plan", tmp_path / "plan.toml", "-o", tmp_path / "d", *SKETCH]
    running = started(words)
    wait_for(tmp_path / "d" / "images" / "view_002.png", running)
    running.send_signal(number)
    said, _ = running.communicate(timeout=60)
    assert running.returncode == (-signal.SIGKILL if number == signal.SIGKILL else cli.EXIT_STOPPED), said
    if number != signal.SIGKILL:
        assert "the same command with --resume takes the others" in said
        assert "Traceback" not in said
    before = load_dataset(tmp_path / "d")
    assert not before.origin["complete"]
    kept = {frame.file: frame for frame in before.frames if (tmp_path / "d" / frame.file).is_file()}
    assert 2 <= len(kept) < 60
    assert say(capsys, *words, "--resume")[0] == 0
    after = load_dataset(tmp_path / "d")
    assert len(after.frames) == 60
    assert all(kept.get(frame.file, frame) == frame for frame in after.frames)
    assert not [path for path in (tmp_path / "d").rglob("*") if path.name.endswith(".tmp")]
