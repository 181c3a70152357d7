"""Folders that commands make: nothing lost, nothing half, nothing of others removed."""

import errno
import os
import subprocess
import sys
from pathlib import Path
from typing import NoReturn

import pytest

from rhizotwin.scenes import atomic, folders
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.lock import lock_file

KILL_POINTS = Path(__file__).parent / "kill_points.py"


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def fail_after_writing(folder: Path, error: BaseException) -> NoReturn:
    (folder / "a").write_text("x")
    raise error


def made(folder: Path, **files: str) -> Path:
    for name, text in files.items():
        atomic.write_text(folder / name.replace("_in_", "/").replace("_", "."), text)
    return folder


FAILURES = {
    "interrupt": (KeyboardInterrupt(), KeyboardInterrupt, "^$"),
    "bug": (RuntimeError(), RuntimeError, "^$"),
    "full disk": (OSError(errno.ENOSPC, "full"), UserError, "out: the disk is full"),
}


@pytest.mark.parametrize(("error", "raised", "says"), FAILURES.values(), ids=FAILURES)
def test_folder_is_removed_on_failure(tmp_path: Path, error: BaseException, raised: type[BaseException], says: str) -> None:
    with pytest.raises(raised, match=says), folders.new_folder(tmp_path / "out") as building:
        fail_after_writing(building, error)
    assert names(tmp_path) == []


def test_folder_that_is_there(tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    with folders.new_folder(out) as building:  # empty: taken
        made(building, a="1")
    with pytest.raises(UserError, match="already exists"), folders.new_folder(out):
        pass
    with pytest.raises(UserError, match="contains a; choose"), folders.new_folder(out, replaces=["b"]):
        pass
    with pytest.raises(RuntimeError), folders.new_folder(out, replaces=["a"]):
        raise RuntimeError
    assert names(out) == ["a"]
    with folders.new_folder(out, replaces=["a"]) as building:
        made(building, b="2")
        assert (out / "a").read_text() == "1"
    assert names(out) == ["b"]
    assert names(tmp_path) == ["out"]


def test_a_file_is_no_folder_nor_holds_one(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(UserError, match="is a file"), folders.new_folder(tmp_path / "file"):
        pytest.fail("nothing begins")
    with pytest.raises(UserError, match="out: this path cannot be written"), folders.new_folder(tmp_path / "file" / "deep" / "out"):
        pytest.fail("nothing begins")


def test_what_others_put_there_meanwhile_stays(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    out = made(tmp_path / "out", result_json="old", pictures_in_a="old", pictures_in_b="old", seen_in_c="old")
    with folders.new_folder(out, replaces=["result.json", "pictures", "seen"]) as building:
        made(building, result_json="new", pictures_in_a="new")
        made(out, work_txt="years", pictures_in_mine="mine", pictures_in_b="painted over")
    assert {str(path.relative_to(out)): path.read_text() for path in sorted(out.rglob("*")) if path.is_file()} == {
        "pictures/a": "new",
        "pictures/b": "painted over",
        "pictures/mine": "mine",
        "result.json": "new",
        "work.txt": "years",
    }
    assert "work.txt was added or changed by another program during the run, and is kept" in caplog.text
    assert names(out) == ["pictures", "result.json", "work.txt"]


@pytest.mark.parametrize("theirs", ["result.json", "pictures", "result.json/deep"])
def test_what_others_put_in_the_way_stays_and_the_work_is_kept(theirs: str, tmp_path: Path) -> None:
    out = tmp_path / "out"

    def work() -> None:
        with folders.new_folder(out) as new:
            made(new, result_json="new", pictures_in_a="new")
            atomic.write_text(out / theirs, "theirs")

    with pytest.raises(UserError, match=rf"out: {theirs} was added .* the output is in .*/out/made-1"):
        work()
    assert (out / theirs).read_text() == "theirs"
    assert (out / "made-1" / "result.json").read_text() == "new"
    assert len(names(out)) == 2


def test_links_mounts_and_the_current_folder_are_goals(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A goal is never renamed or removed: it may be a mount point, the target of a link, or where the shell stands."""
    disk = tmp_path / "disk"
    (disk / "lost+found").mkdir(parents=True)
    (tmp_path / "link").symlink_to(disk)
    before = disk.stat().st_ino
    with folders.new_folder(tmp_path / "link") as building:
        made(building, a="1")
    assert (tmp_path / "link").is_symlink()
    monkeypatch.chdir(disk)
    with folders.new_folder(".", replaces=["a"]) as building:
        made(building, b="2")
    assert names(disk) == ["b", "lost+found"]
    assert disk.stat().st_ino == before


def test_one_process_at_a_time(tmp_path: Path) -> None:
    out = tmp_path / "out"
    with folders.lock_folder(out):
        with pytest.raises(UserError, match=rf"out: process {os.getpid()} on .* is using it; wait"), folders.new_folder(out):
            pass
        folders.check_readable(out)  # a reader does not mind
    assert names(tmp_path) == []


@pytest.mark.skipif(sys.platform == "win32", reason="symbolic links need rights on Windows")
@pytest.mark.parametrize(
    ("name", "kind"), [("linked", "a link, a folder or a device"), ("named_twice", "several names"), ("pipe", "a pipe or a device")]
)
def test_what_is_not_a_lock_file_is_named(tmp_path: Path, name: str, kind: str) -> None:
    (tmp_path / "file").write_text("kept")
    (tmp_path / "linked").symlink_to("file")
    (tmp_path / "named_twice").hardlink_to(tmp_path / "file")
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(UserError, match=rf"{name}: the entry is not a lock file of this program, because it is .*{kind}"):
        lock_file(tmp_path / name, what="it").__enter__()
    assert (tmp_path / "file").read_text() == "kept"


def test_a_lock_of_a_run_that_is_over_is_taken_over_with_a_word(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    out = made(tmp_path / "out", view_in_a="kept")
    (out / folders.LOCK).write_text('{"pid": 7, "host": "gone", "since": "then"}')
    (out / folders.NEW / "half").mkdir(parents=True)
    atomic.temporary_path(out / "view" / "b").write_text("half")
    with folders.lock_folder(out):
        assert names(out / "view") == ["a"]
    assert "process 7 on gone (since then) was stopped before it released its lock; this run takes over the lock" in caplog.text
    assert names(out) == ["view"]


def test_readers_name_what_a_kill_left_and_writers_finish_it(tmp_path: Path) -> None:
    whole, half = made(tmp_path / "whole" / folders.WHOLE, dataset_json="x").parent, made(tmp_path / "half" / folders.OLD, a="1").parent
    with pytest.raises(UserError, match=r"contains .rhizotwin-whole, .* run the same command again"):
        folders.check_readable(whole)
    with pytest.raises(UserError, match="is complete, although the run that wrote it was stopped"), folders.new_folder(whole):
        pass
    with pytest.raises(UserError, match="already exists"), folders.new_folder(half):
        pass
    assert names(whole) == ["dataset.json"]
    assert names(half) == ["a"]


def test_without_locks_of_the_file_system_the_words_tell(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rhizotwin.scenes.lock.try_lock", lambda _: None)
    with lock_file(tmp_path / "lock", what="out"), pytest.raises(UserError, match="is using it"), lock_file(tmp_path / "lock", what="out"):
        pass
    ended = subprocess.run([sys.executable, "-c", "import os; print(os.getpid())"], capture_output=True, text=True, check=True).stdout
    host = os.uname().nodename
    (tmp_path / "lock").write_text(f'{{"pid": {int(ended)}, "host": "{host}", "since": "then"}}')
    with lock_file(tmp_path / "lock", what="out") as left:
        assert left
    (tmp_path / "lock").write_text(f'{{"pid": {int(ended)}, "host": "another", "since": "then"}}')
    with pytest.raises(UserError, match="on another"), lock_file(tmp_path / "lock", what="out"):
        pass


@pytest.mark.parametrize("scenario", ["write", "new", "replace", "scan"])
def test_a_kill_at_any_file_operation_leaves_the_old_or_the_new(scenario: str, tmp_path: Path) -> None:
    words = [sys.executable, str(KILL_POINTS), scenario, str(tmp_path)]
    environment = os.environ | {"OPENBLAS_NUM_THREADS": "1", "PYTHONPATH": str(KILL_POINTS.parents[2])}
    done = subprocess.run(words, capture_output=True, text=True, check=False, timeout=300, env=environment)
    assert done.returncode == 0, done.stdout + done.stderr
    assert int(done.stdout.splitlines()[-1].split()[0]) >= 6, done.stdout


def test_two_processes_on_one_output(tmp_path: Path) -> None:
    words = [sys.executable, str(KILL_POINTS), "race", str(tmp_path)]
    running = [subprocess.Popen([*words, str(k)], stdout=subprocess.PIPE, text=True) for k in range(4)]
    said = "".join(process.communicate(timeout=120)[0] for process in running)
    assert all(process.returncode == 0 for process in running), said
    assert "made" in said
    texts = {path.read_text() for path in (tmp_path / "race").rglob("*") if path.is_file()}
    assert len(texts) == 1
    assert names(tmp_path / "race") == ["deep", "result.json"]
