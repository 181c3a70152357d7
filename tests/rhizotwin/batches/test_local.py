"""Jobs in processes of this computer: memory, stopping, processes that die."""

import json
import os
import signal
import subprocess
import threading
import time
from multiprocessing import Pipe
from pathlib import Path

import pytest

from rhizotwin.batches import jobs, local
from rhizotwin.batches.jobs import Outcome
from tests.rhizotwin.batches.conftest import dataset, job


def test_only_so_many_run_at_once_as_memory_holds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    given: list[str] = []

    class Line:
        def send(self, plain: dict[str, object]) -> None:
            given.append(str(plain["name"]))

    monkeypatch.setattr(local, "_hire", lambda _: local._Worker(None, Line()))
    waiting = [job("large", tmp_path, pixels=40e6), job("huge", tmp_path, pixels=90e6), job("small", tmp_path, pixels=2e6)]
    crew: list[local._Worker] = []
    local._hand_out(waiting, crew, 8, waiting[0].memory_mib + waiting[2].memory_mib)
    assert given == ["large", "small"]
    crew[0].job = crew[1].job = None
    local._hand_out(waiting, crew, 8, 100.0)  # one always runs, however large
    assert given == ["large", "small", "huge"]


def test_jobs_are_stopped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    killed: list[str] = []

    class Process:
        def kill(self) -> None:
            killed.append("killed")

        def join(self) -> None:
            killed.append("joined")

    line, _other = Pipe()
    monkeypatch.setattr(local, "_hire", lambda _: local._Worker(Process(), line))
    monkeypatch.setattr(local, "LOOK_S", 0.01)
    stops = iter([False, False, True])
    assert list(local.run([job("a", tmp_path)], workers=1, stop=lambda: next(stops))) == []
    assert killed == ["killed", "joined"]


def test_a_damaged_scan_fails_with_its_sentence_and_a_killed_process_is_replaced(tmp_path: Path) -> None:
    bad = dataset(tmp_path / "bad")
    given = [job(f"job{k}", tmp_path, source=str(bad)) for k in range(3)]
    outcomes: dict[str, Outcome] = {}
    before = _children()

    def kill() -> None:
        """Kill the first process while it loads."""
        for _ in range(200):
            new = [child for child in _children() - before if "spawn_main" in _command(child)]
            if new:
                time.sleep(0.5)
                os.kill(new[0], signal.SIGKILL)
                return
            time.sleep(0.05)

    killer = threading.Thread(target=kill)
    killer.start()
    for one, outcome in local.run(given, workers=1):
        assert one.name not in outcomes  # nothing twice
        outcomes[one.name] = outcome
    killer.join()
    assert {outcome.state for outcome in outcomes.values()} == {"failed"}
    assert all("the picture is missing" in outcome.sentence for outcome in outcomes.values())
    record = json.loads((tmp_path / jobs.RECORDS / "job1.json").read_text(encoding="utf-8"))
    assert (record["state"], record["key"]) == ("failed", "k")


@pytest.mark.parametrize(("code", "named"), [(-9, "signal SIGKILL"), (-40, "signal 40"), (3, "exit code 3")])
def test_a_process_that_died_names_its_signal(code: int, named: str, tmp_path: Path) -> None:
    class Dead:
        exitcode = code

        def join(self) -> None:
            pass

    ours, theirs = Pipe()
    theirs.close()
    worker = local._Worker(Dead(), ours, job("a", tmp_path))
    assert f"died ({named})" in local._hear(worker, [worker]).sentence


def _children() -> set[int]:
    listed = subprocess.run(["ps", "-o", "pid=", "--ppid", str(os.getpid())], capture_output=True, text=True, check=False)
    return {int(word) for word in listed.stdout.split()}


def _command(pid: int) -> str:
    try:
        return Path(f"/proc/{pid}/cmdline").read_text(encoding="utf-8")
    except OSError:
        return ""
