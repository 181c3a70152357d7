"""The queue of reconstructions: kept on disk, begun again after a kill, with progress and errors."""

import errno
import json
import shutil
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from unittest.mock import Mock

import pytest

from rhizotwin.console import reconstruction_queue
from rhizotwin.console.reconstruction_queue import MOST_DEATHS, Job, Queue, read
from rhizotwin.console.scan_folders import ScanFolders
from rhizotwin.scenes import threads
from rhizotwin.scenes.errors import UserError
from tests.rhizotwin import plant as plants
from tests.rhizotwin.browser import until


@pytest.fixture
def folders(plant: plants.Plant, tmp_path: Path) -> ScanFolders:
    """Return a folder with a complete scan, an interrupted one and one with damaged pictures."""
    found = ScanFolders(tmp_path / "lab")
    for name, complete in (("P7", True), ("P8", False), ("P9", True)):
        path = Path(shutil.copytree(plant.dataset, found.scans / name)) / "dataset.json"
        plain = json.loads(path.read_text())
        path.write_text(json.dumps(plain | {"origin": {**plain.get("origin", {}), "complete": complete}}))
    for picture in (found.scans / "P9" / "images").iterdir():
        picture.write_bytes(picture.read_bytes()[:100])
    return found


@pytest.fixture
def open_queue(folders: ScanFolders) -> Iterator[Callable[..., Queue]]:
    with ExitStack() as stack:

        def make(on_end: Callable[[Job], object] = lambda _: None) -> Queue:
            queue = Queue(folders, on_change=lambda: None, on_end=on_end, on_error=lambda _: None)
            stack.callback(queue.close)
            return queue

        yield make


def states(queue: Queue) -> dict[object, object]:
    return {job["scan"]: job["state"] for job in queue.plain()}


def test_an_interrupted_reconstruction_begins_again(folders: ScanFolders, open_queue: Callable[..., Queue]) -> None:
    queue = open_queue()
    for name, words in (("P8", "not complete"), ("none", "does not exist"), ("../P7", "not a valid name"), ("", "not a valid name")):
        with pytest.raises(UserError, match=words):
            queue.add(name)
    with pytest.raises(UserError, match="not in the queue"):
        queue.remove("P7")
    queue.add("P7")
    with pytest.raises(UserError, match="already in the queue"):
        queue.add("P7")
    until(lambda: queue._process is not None)
    queue._process.kill()
    until(lambda: "it starts again" in queue.plain()[0]["error"] or states(queue)["P7"] == "running")
    until(lambda: queue._process is not None)
    queue.close()  # kills its process, as the end of the console does
    assert [job.state for job in read(folders.root / "queue.json")] == ["running"]
    again = open_queue()
    assert states(again)["P7"] in ("waiting", "running")
    again.remove("P7")
    assert states(again) == {}
    again.close()
    assert read(folders.root / "queue.json") == []


def test_an_error_of_one_job_does_not_end_the_queue(open_queue: Callable[..., Queue], monkeypatch: pytest.MonkeyPatch) -> None:
    dead = reconstruction_queue._DeadError("its process ended unexpectedly")
    monkeypatch.setattr(threads, "PAUSE_S", 0.0)
    ends = [OSError(errno.EMFILE, "Too many open files"), SystemExit("killed"), ZeroDivisionError(), *[dead] * (MOST_DEATHS + 1), ""]
    monkeypatch.setattr(Queue, "_reconstruct", Mock(side_effect=ends))
    queue = open_queue(Mock(side_effect=RuntimeError("the end cannot be shown")))
    states = []
    for words in ("too many files and connections are open", "killed", "ZeroDivisionError", "add the scan to the queue again", "done"):
        queue.add("P7")
        states.append(words in str(until(lambda: queue.plain()[0]["ended"] and queue.plain()[0])))
    assert states == [True] * 5


def test_the_folder_of_the_result_is_checked(folders: ScanFolders, open_queue: Callable[..., Queue], tmp_path: Path) -> None:
    queue, result = open_queue(), folders.results / "P7"
    result.symlink_to(tmp_path)
    with pytest.raises(UserError, match="results/P7 is a symbolic link"):
        queue.add("P7")
    result.unlink()
    result.write_text("")
    with pytest.raises(UserError, match="results/P7 is not a folder"):
        queue.add("P7")
    result.unlink()
    result.mkdir()
    (result / "notes.txt").write_text("")
    with pytest.raises(UserError, match="is not empty and is not a result"):
        queue.add("P7")
    (result / "result.json").write_text("{}")
    with pytest.raises(UserError, match=r"contains notes[.]txt, which would be deleted"):
        queue.add("P7")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("{", "could not be read"),
        ('{"schema_version": 1, "jobs": [{"scan": "../x"}]}', "not a valid name"),
    ],
)
def test_a_damaged_queue_is_named(tmp_path: Path, text: str, words: str) -> None:
    (tmp_path / "queue.json").write_text(text)
    with pytest.raises(UserError, match=words):
        read(tmp_path / "queue.json")


def test_a_full_disk_does_not_end_the_queue(open_queue: Callable[..., Queue], monkeypatch: pytest.MonkeyPatch) -> None:
    queue = open_queue()
    queue.add("P9")
    monkeypatch.setattr("rhizotwin.console.reconstruction_queue.write_json", Mock(side_effect=UserError("the disk is full")))
    until(lambda: states(queue)["P9"] == "failed")
    monkeypatch.undo()
    queue.add("P9")
    until(lambda: states(queue)["P9"] == "failed")
    assert "P9" in queue.plain()[0]["error"]
