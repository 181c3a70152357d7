"""Kill a writer before each of its file operations in turn, and look at what it leaves. Run by test_folders.py in a process of one thread.

python kill_points.py SCENARIO FOLDER kills at every point and prints how many these were; anything lost or left over ends it
with a traceback. Whole commands are killed at random moments by `tests.campaign`.
"""

import os
import shutil
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest

from rhizotwin.scenes import atomic, folders
from rhizotwin.scenes.errors import UserError

OPERATIONS = ("open", "rename", "replace", "link", "fsync", "unlink", "rmdir", "mkdir", "ftruncate")
"""What changes the disk, or makes a change last. A kill before one is a kill after the one before it."""
KILLED = 137
os.fsync = lambda _: None
"""It is counted, and flushes nothing: what was written survives the end of a process, and only a power cut would need it."""


def killed_at(point: int, action: Callable[[], object]) -> bool:
    """Do something in a child that is killed before its ``point``-th operation; return whether it was."""
    child = os.fork()
    if child == 0:
        left = point

        def count(function: Callable[..., object]) -> Callable[..., object]:
            def counted(*arguments: object, **options: object) -> object:
                nonlocal left
                left -= 1
                if left == 0:
                    os._exit(KILLED)
                return function(*arguments, **options)

            return counted

        for name in OPERATIONS:
            setattr(os, name, count(getattr(os, name)))
        try:
            action()
        except BaseException:  # noqa: BLE001 - a child of a test ends here
            sys.excepthook(*sys.exc_info())
            os._exit(1)
        os._exit(0)
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    assert code in (0, KILLED), code
    return code == KILLED


def texts(folder: Path) -> dict[str, str]:
    """Return every file of a folder by its path in it."""
    return {str(path.relative_to(folder)): path.read_bytes().hex()[:40] for path in sorted(folder.rglob("*")) if path.is_file()}


def make(goal: Path, text: str) -> None:
    """Make a result-like folder."""
    with folders.new_folder(goal, replaces=["result.json", "deep", "old", "new"]) as building:
        for name in (f"deep/{text}.png", "deep/both.png", text, "result.json"):
            atomic.write_text(building / name, text)


def look(goal: Path) -> None:
    """Read the folder as commands do: nothing is changed, what has its head is whole, and what has none is said to be unfinished."""
    if not goal.exists():
        return
    before = texts(goal)
    if any((goal / head).is_file() for head in folders.HEADS):
        folders.check_readable(goal)
        whole = {text for name, text in before.items() if name.partition("/")[0] in ("deep", "old", "new", "result.json")}
        assert len(whole) < 2, before
    elif any((goal / mark).is_dir() for mark in (folders.OLD, folders.WHOLE)):
        with pytest.raises(UserError, match="run the same command again"):
            folders.check_readable(goal)
    assert texts(goal) == before


FILES: dict[str, tuple[Callable[[Path], object], Callable[[Path], object]]] = {
    # a file is the old or the new, and the next write clears what is left
    "write": (lambda work: atomic.write_text(work / "a.txt", "old"), lambda work: atomic.write_text(work / "a.txt", "new")),
    "new": (lambda _: None, lambda work: make(work / "goal", "new")),
    "replace": (lambda work: make(work / "goal", "old"), lambda work: make(work / "goal", "new")),
}
"""What is there before, and what is killed: afterwards there is the old or the new."""


def scan(work: Path) -> int:
    """Scan: every listed picture that is there is the recorded one, and the scan is finished from wherever it was killed."""
    import numpy as np

    from rhizotwin.rig.rig_file import RigFile
    from rhizotwin.rig.scanning.session import open_session, picture_file
    from rhizotwin.scenes import plan
    from rhizotwin.scenes.dataset import Frame, file_sha256, load_dataset
    from rhizotwin.scenes.model import CapturePlan, Ring, Scene

    goal, scene = work / "goal", Scene(plan=CapturePlan(rings=(Ring(views=3),)))
    planned = plan.views(scene)

    def look() -> None:
        if (goal / "dataset.json").is_file():
            for frame in load_dataset(goal).frames:
                assert not (goal / frame.file).is_file() or file_sha256(goal / frame.file) == frame.sha256

    def action() -> None:
        with folders.lock_folder(goal):
            session = open_session(goal, scene, planned, rig=RigFile(name="r"), resume=True)
            for view in session.remaining():
                frame = Frame(file=picture_file(view), sha256="", kind="root", ring=0, table_deg=view.table_deg, time_s=1.0)
                session.record(frame, np.full((4, 6), view.index, np.uint8))
            done = session.save(complete=True)
            session.close()
        assert done.origin["complete"]
        assert [file_sha256(goal / frame.file) for frame in load_dataset(goal).frames] == [frame.sha256 for frame in done.frames]
        assert len(done.frames) == len(planned)

    return every(lambda: None, action, work, reader=look, in_part=True)


def every(
    before: Callable[[], object],
    action: Callable[[], object],
    work: Path,
    *,
    reader: Callable[[], None],
    in_part: bool = False,
) -> int:
    """Kill ``action`` at each of its operations, look, then do it again; return how many there were.

    Where the action may leave a part of what it does, the reader alone judges that.
    """
    states = []
    for point in range(1, 100_000):
        shutil.rmtree(work, ignore_errors=True)
        work.mkdir()
        before()
        old = texts(work)
        killed = killed_at(point, action)
        if not killed:
            states.append(texts(work))
            break
        reader()  # whoever opens it next
        folders.recover(work / "goal")  # the first that the same command does
        states.append({name: text for name, text in texts(work).items() if not name.rpartition("/")[2].startswith(".")})
        try:
            action()
        except UserError as error:  # it was done before the kill
            if "already exists" not in str(error):
                raise
        states.append(texts(work))
        left = [path for path in work.rglob(".*") if path.name != ".rhizotwin-jobs"]
        assert not left, left
    done = states[-1]
    assert old != done
    for k, state in enumerate(states):
        if k % 2 or not in_part:
            assert state in ((old, done) if k % 2 == 0 else (done,)), (k, state, old, done)
    return len(states) // 2


def race(work: Path, text: str) -> None:
    """Make one folder again and again beside others that do the same."""
    for _ in range(20):
        try:
            with folders.new_folder(work, replaces=["result.json", "deep"]) as building:
                for name in ("deep/a", "deep/b", "result.json"):
                    atomic.write_text(building / name, text)
        except UserError as error:
            if "is using it" not in str(error) and "lock it repeatedly" not in str(error):
                raise
        else:
            sys.stdout.write("made\n")


if __name__ == "__main__":
    work = Path(sys.argv[2])
    if sys.argv[1] == "race":
        race(work / "race", sys.argv[3])
    else:
        name, folder = sys.argv[1], work / "work"
        if name == "scan":
            points = scan(folder)
        else:
            before, action = (partial(function, folder) for function in FILES[name])
            points = every(before, action, folder, reader=lambda: look(folder / "goal"))
        sys.stdout.write(f"{points} points\n")
