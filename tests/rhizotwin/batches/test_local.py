"""Jobs in processes of this computer: memory, and processes that die."""

import threading
import time
from multiprocessing import active_children
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import Mock

import pytest

from rhizotwin.batches import local, work
from rhizotwin.batches.jobs import Outcome
from rhizotwin.batches.run import LOCK, run
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.lock import lock_file
from tests.rhizotwin.batches.conftest import dataset, job
from tests.rhizotwin.browser import until


def test_only_so_many_run_at_once_as_memory_holds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    given: list[str] = []
    line = SimpleNamespace(send=lambda plain: given.append(plain["name"]))
    monkeypatch.setattr(local, "_hire", lambda _: local._Worker(None, line))
    waiting = [job("large", tmp_path, pixels=40e6), job("huge", tmp_path, pixels=90e6), job("small", tmp_path, pixels=2e6)]
    assert job("few", tmp_path, pixels=0.12e6).memory_mib > 1721.0, "4 pictures of 200x150"
    crew: list[local._Worker] = []
    local._hand_out(waiting, crew, 8, waiting[0].memory_mib + waiting[2].memory_mib)
    assert given == ["large", "small"]
    crew[0].job = crew[1].job = None
    local._hand_out(waiting, crew, 8, 100.0)  # one always runs, however large
    assert given == ["large", "small", "huge"]


def test_a_damaged_scan_fails_and_a_killed_process_is_replaced(tmp_path: Path) -> None:
    bad = dataset(tmp_path / "bad")
    given = [job(f"job{k}", tmp_path, source=str(bad)) for k in range(3)]
    before = set(active_children())

    def kill() -> None:
        """Kill the first process while it loads."""
        (process,) = until(lambda: set(active_children()) - before, "a process")
        time.sleep(0.5)
        process.kill()

    killer = threading.Thread(target=kill)
    killer.start()
    outcomes = list(local.run(given, workers=1))
    killer.join()
    assert sorted(one.name for one, _ in outcomes) == ["job0", "job1", "job2"]  # nothing twice
    assert {outcome.state for _, outcome in outcomes} == {"failed"}
    assert all("the picture is missing" in outcome.sentence for _, outcome in outcomes)


def test_a_full_disk_is_not_the_scans_fault(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    full = Mock(side_effect=OSError(28, "No space left on device", "result"))
    monkeypatch.setattr(work, "_reconstruct", full)
    outcome = Outcome(**work.work(job("a", tmp_path).plain()))
    assert (outcome.state, outcome.sentence) == ("again", "result: the disk is full; free some space and run the same command again")


def test_two_batches_do_not_work_in_one_folder(tmp_path: Path) -> None:
    with lock_file(tmp_path / LOCK, what="it"), pytest.raises(UserError, match="is using it"):
        run([job("a", tmp_path)], str(tmp_path))
