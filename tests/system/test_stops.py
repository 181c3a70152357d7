"""A full disk and Ctrl-C at many moments of every command: one sentence, nothing half-written, and a second run finishes."""

import importlib
import os
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

import rhizotwin.scenes.atomic
import rhizotwin.scenes.folders
import rhizotwin.sim.simulate
from rhizotwin.commands import cli
from rhizotwin.importer import picture_copy, picture_import
from rhizotwin.recon import carved_hull, read_pictures, reconstruct
from rhizotwin.recon.coverage import silhouettes
from rhizotwin.recon.results import result
from rhizotwin.report import result_pictures as report

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("coarse_ball")]

ROOT = Path(__file__).resolve().parents[2]
SIMULATE = ("simulate", "sphere_20mm", "--views", "3", "--image-wh", "48x36", "--device", "cpu")
FAST = ("--device", "cpu", "--voxel-mm", "2")


def bytes_of(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def no_temporary(folder: Path) -> None:
    assert not [path for path in folder.rglob("*") if path.name.endswith(".tmp")]


@dataclass(frozen=True)
class Moment:
    """A call of a function, at which Ctrl-C is pressed, or from which on the disk is full."""

    owner: Any
    name: str
    at: int = 1
    full: bool = False

    def __str__(self) -> str:
        """Return what the test is called."""
        return f"{'full' if self.full else 'stop'}-{self.name}-{self.at}"


def writes(*numbers: int, full: bool = False) -> list[Moment]:
    """Return moments of writing: the flush of a file or folder before or after it is renamed."""
    return [Moment(rhizotwin.scenes.atomic.os, "fsync", number, full) for number in numbers]


def stopped(moment: Moment, command: Any, fault: Any, *words: Any, says: str = "interrupted") -> None:
    """Run a command, whose last word is its folder, that the moment stops; mend the fault."""
    inject = fault.full_disk if moment.full else fault.stop
    injected = inject(moment.owner, moment.name, at=moment.at)
    if moment.full:
        done = command.fails(*words, named=[words[-1], "the disk is full", "free some space"])
    else:
        done = command.fails(*words, named=["interrupted", says], code=130)
    assert ".tmp" not in done.sentence
    assert injected.calls >= moment.at
    fault.mend()


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Simulate a set of a coarse ball, which the tests simulate too, without disturbance."""
    out = tmp_path_factory.mktemp("small") / "out"
    assert cli.main([*SIMULATE, "-o", str(out)]) == 0
    return out


@pytest.fixture
def quick_shape(found: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let `reconstruct` write the result that is known already, so that only what comes after the shape takes time."""
    monkeypatch.setattr(reconstruct, "reconstruct", lambda _, **__: found.result)


SIMULATE_MOMENTS = [
    # each file is flushed and then its folder: 2 calls a file; the progress file is the first, then specimen, picture, mask, progress
    *writes(23, full=True),
    *writes(5),
    Moment(rhizotwin.sim.simulate.Renderer, "view", 2),
    Moment(Path, "replace", 4),
    Moment(rhizotwin.sim.simulate, "save_dataset"),
]


@pytest.mark.parametrize("moment", SIMULATE_MOMENTS, ids=str)
def test_stopped_simulate_goes_on(moment: Moment, small: Path, tmp_path: Path, command: Any, fault: Any) -> None:
    out = tmp_path / "out"
    stopped(moment, command, fault, *SIMULATE, "-o", out, says="the same command")
    no_temporary(tmp_path)
    assert not (out / "dataset.json").exists()
    assert all(path.read_bytes().endswith(b"IEND\xaeB`\x82") for path in out.rglob("*.png"))
    command.works(*SIMULATE, "-o", out)
    assert bytes_of(out) == bytes_of(small)


IMPORT_MOMENTS = [*writes(23, full=True), Moment(picture_copy, "read_picture", 2), Moment(picture_import, "save_dataset")]


@pytest.mark.parametrize("moment", IMPORT_MOMENTS, ids=str)
def test_stopped_import_starts_again(moment: Moment, made: Path, rig: Path, tmp_path: Path, command: Any, fault: Any) -> None:
    words = ("import", made / "images", "--scene", rig, "-o", tmp_path / "out")
    stopped(moment, command, fault, *words)
    assert list(tmp_path.iterdir()) == []
    command.works(*words)


EARLY = [Moment(read_pictures, "read_image", 3), Moment(silhouettes.Silhouette, "cut", 4), Moment(carved_hull.carve, "carve")]
LATE = [*writes(46, full=True), *writes(45), Moment(result.atomic, "write_json"), Moment(report, "write_pictures")]
"""By turns over an earlier result and into a new folder."""


def stop_reconstruct(moment: Moment, scan: Path, command: Any, fault: Any, out: Path) -> None:
    before = bytes_of(scan)
    stopped(moment, command, fault, "reconstruct", scan / "dataset", *FAST, "-o", out, says="nothing was written")
    assert bytes_of(scan) == before
    no_temporary(scan)


@pytest.mark.parametrize("moment", EARLY, ids=str)
def test_ctrl_c_while_reconstruct_computes(moment: Moment, scan: Path, command: Any, fault: Any) -> None:
    stop_reconstruct(moment, scan, command, fault, scan / "new")
    assert not (scan / "new").exists()


@pytest.mark.usefixtures("quick_shape")
@pytest.mark.parametrize(("moment", "name"), [(moment, ("result", "new")[k % 2]) for k, moment in enumerate(LATE)], ids=str)
def test_stops_while_reconstruct_writes(moment: Moment, name: str, scan: Path, command: Any, fault: Any) -> None:
    stop_reconstruct(moment, scan, command, fault, scan / name)


@pytest.mark.usefixtures("quick_shape")
@pytest.mark.parametrize("late", [False, True], ids=["before all is whole", "too late"])
def test_ctrl_c_while_files_are_moved(late: bool, scan: Path, command: Any, fault: Any) -> None:
    fault.patch.setattr(report, "write_pictures", lambda *_, **__: [])
    before = bytes_of(scan / "result")
    fault.stop(Path, "rename", at=len(before) + (2 if late else 1))
    words = ("reconstruct", scan / "dataset", "-o", scan / "result", *FAST)
    if late:
        command.works(*words)
    else:
        command.fails(*words, named=["interrupted", "nothing was written"], code=130)
    assert (bytes_of(scan / "result") == before) is not late
    assert (scan / "result" / "report.html").is_file()
    assert not list(scan.rglob(".rhizotwin-*"))


def test_an_interrupted_save_keeps_the_earlier_result(found: Any, scan: Path, fault: Any) -> None:
    """For whoever calls the library: a folder holds a whole result, the new or the earlier one."""

    def files() -> dict[Path, bytes]:
        return {path: path.read_bytes() for path in (scan / "result").rglob("*") if path.is_file()}

    before = files()
    assert any(path.name == "result.json" for path in before)
    fault.stop(result.atomic, "write_bytes", at=1)
    with pytest.raises(KeyboardInterrupt):
        found.result.save(scan / "result")
    assert files() == before


def test_ctrl_c_pressed_twice_lets_the_tidying_finish(made: Path, rig: Path, tmp_path: Path, command: Any, fault: Any) -> None:
    tidy = rhizotwin.scenes.folders.shutil.rmtree

    def press_again(*arguments: Any, **options: Any) -> None:
        signal.raise_signal(signal.SIGINT)
        tidy(*arguments, **options)

    fault.patch.setattr(rhizotwin.scenes.folders.shutil, "rmtree", press_again)
    fault.patch.setattr(picture_import, "save_dataset", lambda _: signal.raise_signal(signal.SIGINT))
    command.fails("import", made / "images", "--scene", rig, "-o", tmp_path / "out", named=["interrupted"], code=130)
    assert list(tmp_path.iterdir()) == []


def test_ctrl_c_swallowed_by_a_library_that_loads(tmp_path: Path, command: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    careless = "import signal\ntry:\n    signal.raise_signal(signal.SIGINT)\nexcept BaseException:\n    pass\n"
    (tmp_path / "careless_library.py").write_text(careless)
    monkeypatch.syspath_prepend(tmp_path)

    def load_and_work() -> None:
        importlib.import_module("careless_library")
        for _ in range(200):
            time.sleep(0.02)

    monkeypatch.setattr("rhizotwin.commands.scenes.scenes", load_and_work)
    command.fails("scenes", named=["interrupted"], code=130)


@pytest.mark.skipif(os.name != "posix", reason="signals of a terminal")
def test_real_signal_in_reconstruct(made: Path, tmp_path: Path) -> None:
    words = ["reconstruct", str(made), "-o", str(tmp_path / "out"), "--voxel-mm", "0.05", "--device", "cpu"]
    process = subprocess.Popen([sys.executable, "-m", "rhizotwin", *words], cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    assert process.stderr is not None
    said = b""
    while b"outlines" not in said and (more := process.stderr.read1()):
        said += more
    process.send_signal(signal.SIGTERM)
    said += process.communicate(timeout=60.0)[1]
    assert process.returncode == cli.EXIT_STOPPED, said.decode()
    assert said.decode().endswith("rhizotwin: interrupted; nothing was written\n"), said.decode()
    assert b"Traceback" not in said
    assert list(tmp_path.iterdir()) == []
