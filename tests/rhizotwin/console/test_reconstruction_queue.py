"""The queue of reconstructions: kept on disk, begun again after a kill, with progress and errors."""

import json
import shutil
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from unittest.mock import Mock

import pytest

from rhizotwin.console.reconstruction_queue import Job, Queue, read
from rhizotwin.console.scan_folders import ScanFolders
from rhizotwin.scenes.errors import UserError
from tests.rhizotwin import plant as plants
from tests.rhizotwin.console.conftest import until


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> plants.Plant:
    return plants.make(tmp_path_factory.mktemp("made"))


@pytest.fixture
def folders(made: plants.Plant, tmp_path: Path) -> ScanFolders:
    """Return a folder with a complete scan, an interrupted one and one with damaged pictures."""
    found = ScanFolders(tmp_path / "lab")
    for name, complete in (("P7", True), ("P8", False), ("P9", True)):
        path = Path(shutil.copytree(made.dataset, found.scans / name)) / "dataset.json"
        plain = json.loads(path.read_text())
        path.write_text(json.dumps(plain | {"origin": {**plain.get("origin", {}), "complete": complete}}))
    for picture in (found.scans / "P9" / "images").iterdir():
        picture.write_bytes(picture.read_bytes()[:100])
    return found


@pytest.fixture
def open_queue(folders: ScanFolders) -> Iterator[Callable[..., Queue]]:
    with ExitStack() as stack:

        def make(on_end: Callable[[Job], object] = lambda _: None) -> Queue:
            queue = Queue(folders, on_change=lambda: None, on_end=on_end)
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
    until(lambda: states(queue)["P7"] == "running")
    queue.close()  # kills its process, as the end of the console does
    assert [job.state for job in read(folders.root / "queue.json")] == ["running"]
    again = open_queue()
    assert states(again)["P7"] in ("waiting", "running")
    again.remove("P7")
    assert states(again) == {}
    again.close()
    assert read(folders.root / "queue.json") == []


@pytest.mark.slow
def test_reconstructions_end_with_a_report_or_a_reason(folders: ScanFolders, open_queue: Callable[..., Queue]) -> None:
    ended: list[Job] = []
    queue = open_queue(ended.append)
    queue.add("P9")
    queue.add("P7")
    stages: set[object] = set()

    def both_ended() -> bool:
        stages.update(job.get("stage") for job in queue.plain())
        return len(ended) == 2

    until(both_ended)
    assert [(job.scan, job.state) for job in ended] == [("P9", "failed"), ("P7", "done")]
    assert "P9" in ended[0].error
    assert len(stages) > 3
    assert folders.report("P7").stat().st_size > 10_000
    assert folders.result_of("P7") is not None
    assert folders.result_of("P9") is None


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("{", "could not be read"),
        ('{"schema_version": 2, "jobs": []}', "schema_version 2"),
        ('{"schema_version": 1, "jobs": [{"scan": "../x"}]}', "not a valid name"),
        ('{"schema_version": 1, "jobs": [{"scn": "x"}]}', "scn"),
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
