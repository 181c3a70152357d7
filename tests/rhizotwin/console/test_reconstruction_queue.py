"""The queue of reconstructions: kept on disk, begun again after a kill, with progress and errors."""

import json
import shutil
from pathlib import Path

import pytest

from rhizotwin.console.reconstruction_queue import Job, Queue, read
from rhizotwin.console.scan_folders import ScanFolders
from rhizotwin.scenes.errors import UserError
from tests.rhizotwin import plant as plants
from tests.rhizotwin.console.conftest import until


@pytest.fixture
def folders(tmp_path: Path) -> ScanFolders:
    """Return a folder with a complete scan, an interrupted one and one with damaged pictures."""
    made = plants.make(tmp_path / "made")
    found = ScanFolders(tmp_path / "lab")
    for name, complete in (("P7", True), ("P8", False), ("P9", True)):
        shutil.copytree(made.dataset, found.scans / name)
        path = found.scans / name / "dataset.json"
        plain = json.loads(path.read_text())
        plain["origin"] = {**plain.get("origin", {}), "complete": complete}
        path.write_text(json.dumps(plain))
    for picture in (found.scans / "P9" / "images").iterdir():
        picture.write_bytes(picture.read_bytes()[:100])
    return found


def open_queue(folders: ScanFolders, ended: list[Job] | None = None) -> Queue:
    return Queue(folders, on_change=lambda: None, on_end=lambda job: None if ended is None else ended.append(job))


def states(queue: Queue) -> dict[object, object]:
    return {job["scan"]: job["state"] for job in queue.plain()}


def test_refusals(folders: ScanFolders) -> None:
    queue = open_queue(folders)
    try:
        for name, words in (("P8", "not complete"), ("none", "does not exist"), ("../P7", "not a valid name"), ("", "not a valid name")):
            with pytest.raises(UserError, match=words):
                queue.add(name)
        with pytest.raises(UserError, match="not in the queue"):
            queue.remove("P7")
    finally:
        queue.close()


def test_an_interrupted_reconstruction_begins_again(folders: ScanFolders) -> None:
    queue = open_queue(folders)
    queue.add("P7")
    with pytest.raises(UserError, match="already in the queue"):
        queue.add("P7")
    until(lambda: states(queue)["P7"] == "running")
    queue.close()  # kills its process, as the end of the console does
    assert [job.state for job in read(folders.root / "queue.json")] == ["running"]
    again = open_queue(folders)
    try:
        assert states(again)["P7"] in ("waiting", "running")
        again.remove("P7")
        assert states(again) == {}
    finally:
        again.close()
    assert read(folders.root / "queue.json") == []


@pytest.mark.slow
def test_reconstructions_end_with_a_report_or_a_reason(folders: ScanFolders) -> None:
    ended: list[Job] = []
    queue = open_queue(folders, ended)
    try:
        queue.add("P9")
        queue.add("P7")
        stages: set[object] = set()

        def has_ended(number: int) -> bool:
            stages.update(job.get("stage") for job in queue.plain())
            return len(ended) == number

        until(lambda: has_ended(1))
        until(lambda: has_ended(2))
    finally:
        queue.close()
    assert [(job.scan, job.state) for job in ended] == [("P9", "failed"), ("P7", "done")]
    assert "P9" in ended[0].error
    assert len(stages) > 3
    assert folders.report("P7").stat().st_size > 10_000
    assert folders.result_of("P7") is not None
    assert folders.result_of("P9") is None


def test_a_damaged_queue_is_named(folders: ScanFolders) -> None:
    path = folders.root / "queue.json"
    for text, words in (
        ("{", "could not be read"),
        ('{"schema_version": 2, "jobs": []}', "schema_version 2"),
        ('{"schema_version": 1, "jobs": [{"scan": "../x"}]}', "not a valid name"),
        ('{"schema_version": 1, "jobs": [{"scn": "x"}]}', "scn"),
    ):
        path.write_text(text)
        with pytest.raises(UserError, match=words):
            open_queue(folders)


def test_a_full_disk_does_not_end_the_queue(folders: ScanFolders, monkeypatch: pytest.MonkeyPatch) -> None:
    queue = open_queue(folders)
    try:
        queue.add("P9")

        def full(*_: object) -> None:
            raise UserError("the disk is full")

        monkeypatch.setattr("rhizotwin.console.reconstruction_queue.write_json", full)
        until(lambda: states(queue)["P9"] == "failed")
        monkeypatch.undo()
        queue.add("P9")
        until(lambda: states(queue)["P9"] == "failed")
    finally:
        queue.close()
