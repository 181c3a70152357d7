"""The command line: what it accepts, and how every failure ends: one sentence, an exit code, no traceback."""

import errno
import inspect
import re
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

import pytest

from rhizotwin import cli, command_line
from rhizotwin.arguments import SceneChanges
from rhizotwin.commands import COMMANDS, GROUPS, place
from rhizotwin.commands.simulate import Rendering
from rhizotwin.scene_changes import change_scene
from rhizotwin.scenes import files
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.specimens import MeshSpecimen, RsmlSpecimen

ROOT = Path(__file__).resolve().parents[2]


def run_and_fail(arguments: Sequence[str], capsys: pytest.CaptureFixture[str]) -> tuple[int, str]:
    """Run a command line that must fail; return its exit code and the one sentence it leaves on stderr."""
    code = cli.main(arguments)
    said = capsys.readouterr().err
    lines = said.splitlines()
    assert len(lines) == 1, said
    assert lines[0].startswith("rhizotwin: ")
    assert "Traceback" not in said
    assert code != 0
    return code, lines[0]


@pytest.mark.parametrize("command", ["", *COMMANDS])
def test_help_teaches(command: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "160")
    assert cli.main([*command.split(), "--help"]) == 0
    said = capsys.readouterr().out
    assert f"Usage: rhizotwin {command}".rstrip() in said
    assert re.search(rf"^  (  )?rhizotwin {command}".rstrip(), said, re.MULTILINE), "no example"
    assert "None" not in said
    for option in re.findall(r"^│ [* ] +(--[a-z-]+.*?)│$", said, re.MULTILINE):
        assert re.search(r"  \w", option), f"{option.strip()} is not explained"


@pytest.mark.parametrize("name", COMMANDS)
def test_the_table_of_commands_has_the_first_line_of_each_help(name: str) -> None:
    module, _, function = place(name).partition(":")
    source = import_module(module) if name in GROUPS else getattr(import_module(module), function)
    assert inspect.getdoc(source).splitlines()[0] == COMMANDS[name]


def test_help_of_all_commands_and_the_list_of_scenes_load_nothing_heavy() -> None:
    heavy = ("numpy", "scipy", "mitsuba", "drjit", "trimesh", "skimage", "matplotlib", "manifold3d", "cv2")
    program = (
        "import sys; from rhizotwin import cli; from rhizotwin.commands import COMMANDS\n"
        "for command in ('', *COMMANDS): cli.main([*command.split(), '--help'])\n"
        f"cli.main(['scenes']); print([name for name in {heavy} if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=True, timeout=120)
    assert done.stdout.splitlines()[-1] == "[]"


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_the_shell_can_complete_commands_and_options(shell: str) -> None:
    script = command_line.build().generate_completion(shell=shell)
    for word in ("reconstruct", "voxel-mm", "calibrate", "printed-ruler-mm", "backlit"):
        assert word in script


def arguments_of(words: str) -> inspect.BoundArguments:
    """Return what a command line gives to its function."""
    bound = command_line.bind(words.split())[1]
    bound.apply_defaults()
    return bound


def test_defaults_of_the_options() -> None:
    given = arguments_of("simulate sphere_20mm -o d").arguments
    assert (given["changes"], given["seed"], given["rendering"], given["device"]) == (SceneChanges(), 0, Rendering(), "auto")
    assert arguments_of("reconstruct d -o r --voxel-mm 0.1").arguments["voxel_mm"] == 0.1
    assert arguments_of("simulate s -o d --image-wh 800X600").arguments["changes"].image_wh == (800, 600)


@dataclass(frozen=True)
class Mistake:
    """A command line that cannot be meant, and what the complaint must name."""

    words: str
    named: str


MISTAKES = [
    Mistake("simulat sphere_20mm", "simulat"),
    Mistake("simulate sphere_20mm", "-o"),
    Mistake("simulate sphere_20mm -o d --views 0", "--views"),
    Mistake(f"simulate sphere_20mm -o d --views {100_000 * '['}", "whole number"),
    Mistake(f"plan sphere_20mm -o d --views {100_000 * '['}", "nested deeper"),
    Mistake("simulate sphere_20mm -o d --views many", "'many' is not a whole number"),
    Mistake("simulate sphere_20mm -o d --seed -1", "--seed"),
    Mistake("simulate sphere_20mm -o d --image-wh 800", "800x600"),
    Mistake("simulate sphere_20mm -o d --image-wh 8x6", "16 to 20000"),
    Mistake("simulate sphere_20mm -o d --image-wh -8x6", "--image-wh"),
    Mistake("simulate sphere_20mm -o d --fidelity best", "best"),
    Mistake("simulate sphere_20mm -o d --device tpu", "tpu"),
    Mistake("simulate sphere_20mm -o d --profile foggy", "foggy"),
    Mistake("simulate no_such_scene -o d", "no_such_scene"),
    Mistake("simulate no_such_file.toml -o d", "no_such_file.toml"),
    Mistake("simulate sphere_20mm -o d --specimen no_such.stl", "no_such.stl"),
    Mistake("simulate sphere_20mm -o d --specimen no_such.stl --specimen-unit cm", "--specimen-unit cm is for traced roots only"),
    Mistake("simulate sphere_20mm -o d --specimen-diameter-mm 0.5", "--specimen-diameter-mm 0.5 is for traced roots only"),
    Mistake("simulate sphere_20mm -o d --specimen a.rsml --specimen-diameter-mm 0", "--specimen-diameter-mm: 0 is out of range"),
    Mistake("reconstruct no_such_dataset -o r", "no_such_dataset"),
    Mistake("reconstruct d -o r --voxel-mm 0", "0.01 to 10 mm"),
    Mistake("reconstruct d -o r --voxel-mm nan", "0.01 to 10 mm"),
    Mistake("import no_such_folder --scene sphere_20mm -o d", "no_such_folder"),
    Mistake("import pictures -o d", "--scene"),
    Mistake("score no_such_result no_such_dataset", "no_such_result"),
    Mistake("score no_such_result", "--volume-ml"),
    Mistake("score no_such_result --truth a.stl --volume-ml 8", "give one thing"),
    Mistake("score no_such_result --truth no_such.stl", "no_such.stl"),
    Mistake("score no_such_result --volume-ml 0", "--volume-ml"),
    Mistake("scenes sphere_20mm", "-o FILE"),
    Mistake("scenes sphere_20mm --specimen-stl a.obj", ".stl"),
]


@pytest.mark.parametrize(("words", "named"), [("", "reconstruct"), ("rig", "jog")])
def test_a_command_or_group_alone_prints_its_help(words: str, named: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(words.split()) == 0
    assert named in capsys.readouterr().out


@pytest.mark.parametrize("mistake", MISTAKES, ids=lambda mistake: mistake.words[:80] or "nothing")
def test_mistake_ends_in_one_sentence(
    mistake: Mistake, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "80")
    code, said = run_and_fail(mistake.words.split(), capsys)
    assert code == cli.EXIT_MISTAKE
    assert mistake.named in said
    assert list(tmp_path.iterdir()) == []


@dataclass(frozen=True)
class Stop:
    """What can go wrong inside a command, the exit code, and what must be said."""

    error: BaseException
    code: int
    said: str


STOPS = [
    Stop(UserError("views/a.png is\ncut short; copy it again"), 2, "views/a.png is cut short; copy it again"),
    Stop(KeyboardInterrupt(), 130, "stopped; nothing was written; run it again"),
    Stop(OSError(errno.ENOSPC, "No space left on device", "out/a.png"), 2, "out/a.png: the disk is full; free some space"),
    Stop(PermissionError(errno.EACCES, "Permission denied", "out"), 1, "out: Permission denied"),
    Stop(MemoryError(), 1, "not enough memory"),
    Stop(ValueError("shapes\ndiffer"), 1, "unexpected error (ValueError: shapes differ); run it again with RHIZOTWIN_DEBUG=1"),
]


@pytest.mark.parametrize("stop", STOPS, ids=lambda stop: type(stop.error).__name__)
def test_failure_inside_a_command(stop: Stop, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.delenv(cli.DEBUG_VARIABLE, raising=False)

    def fail() -> None:
        raise stop.error

    monkeypatch.setattr("rhizotwin.commands.scenes.scenes", fail)
    code, said = run_and_fail(["scenes"], capsys)
    assert code == stop.code
    assert stop.said in said


def test_stop_that_a_library_reports_as_its_own_error(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """Ctrl-C while an extension loads comes out of it as an ImportError."""

    def load() -> None:
        try:
            signal.raise_signal(signal.SIGINT)
        except KeyboardInterrupt:
            raise ImportError("the extension could not be initialised") from None

    monkeypatch.setattr("rhizotwin.commands.scenes.scenes", load)
    before = signal.getsignal(signal.SIGINT)
    code, said = run_and_fail(["scenes"], capsys)
    assert code == cli.EXIT_STOPPED
    assert "stopped" in said
    assert signal.getsignal(signal.SIGINT) is before


def test_ctrl_c_in_a_running_simulation(tmp_path: Path) -> None:
    out = tmp_path / "out"
    words = ["simulate", "sphere_20mm", "-o", str(out), "--views", "2000", "--image-wh", "64x48", "--device", "cpu"]
    process = subprocess.Popen([sys.executable, "-m", "rhizotwin", *words], stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, cwd=ROOT)
    deadline = time.monotonic() + 60.0
    while not list(out.glob("images/*.png")) and process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.02)
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=60.0)
    assert process.returncode == cli.EXIT_STOPPED
    assert said.decode().splitlines()[-1] == "rhizotwin: stopped; the same command takes it up again"
    assert "Traceback" not in said.decode()
    assert not (out / "dataset.json").exists()
    assert not [path for path in tmp_path.rglob("*") if path.name.endswith(".tmp")]
    assert all(path.read_bytes().endswith(b"IEND\xaeB`\x82") for path in out.glob("images/*.png"))


def test_debug_variable_shows_the_traceback(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setenv(cli.DEBUG_VARIABLE, "1")

    def fail() -> None:
        raise ValueError("inside")

    monkeypatch.setattr("rhizotwin.commands.scenes.scenes", fail)
    assert cli.main(["scenes"]) == cli.EXIT_FAILED
    assert "Traceback" in capsys.readouterr().err


def test_scenes_lists_library_and_profiles(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["scenes"]) == 0
    said = capsys.readouterr().out
    for name in ("sphere_20mm", "printed_8ml", "radish_day05a", "radish_day30c", "fallen_plant", "clean", "bench", "harsh"):
        assert sum(line.split()[:1] == [name] for line in said.splitlines()) == 1


def test_copy_of_a_scene_is_the_same_scene(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "mine.toml"
    assert cli.main(["scenes", "printed_8ml", "-o", str(path)]) == 0
    assert files.load_scene(path) == files.load_scene("printed_8ml")
    capsys.readouterr()
    _, said = run_and_fail(["scenes", "printed_8ml", "-o", str(path)], capsys)
    assert "exists already" in said


def test_options_change_the_scene(tmp_path: Path) -> None:
    scene = files.load_scene("sphere_20mm")
    changed = change_scene(scene, views=7, image_wh=(400, 300), profile="bench")
    assert [ring.views for ring in changed.plan.rings] == [7] * len(scene.plan.rings)
    assert changed.camera.image_wh == (400, 300)
    assert changed.camera.focal_px[0] == pytest.approx(scene.camera.focal_px[0] * 400 / scene.camera.image_wh[0])
    assert changed.disturbances == files.load_profile("bench")
    assert change_scene(scene) == scene
    for name, kind in (("a.STL", MeshSpecimen), ("a.ply", MeshSpecimen), ("a.rsml", RsmlSpecimen)):
        file = tmp_path / name
        file.touch()
        specimen = change_scene(scene, specimen=file).specimen
        assert isinstance(specimen, kind)
        assert Path(specimen.file) == file
    assert change_scene(scene, specimen=file, specimen_unit="cm", specimen_diameter_mm=0.5).specimen == RsmlSpecimen(
        file=str(file), unit="cm", diameter_mm=0.5
    )


def test_result_never_overwrites_what_is_no_result(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "thesis.txt").write_text("years of work")
    _, said = run_and_fail(["reconstruct", str(tmp_path / "dataset"), "-o", str(tmp_path)], capsys)
    assert "no result" in said
    assert (tmp_path / "thesis.txt").read_text() == "years of work"


def test_demo_never_overwrites_what_is_no_demo(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "dataset").mkdir()
    (tmp_path / "dataset" / "mine.png").touch()
    _, said = run_and_fail(["demo", "-o", str(tmp_path)], capsys)
    assert "not made by the demo" in said
    assert (tmp_path / "dataset" / "mine.png").exists()
