"""Jobs on a Dask scheduler: a worker that is killed, the keys of jobs, and the memory that SLURM is asked for."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from tests.rhizotwin.batches.conftest import dataset, job
from tests.rhizotwin.browser import until

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture
def scheduler(tmp_path: Path) -> Iterator[tuple[str, list[subprocess.Popen[bytes]]]]:
    """Return a scheduler's address and its two workers."""
    pytest.importorskip("distributed")
    environment = os.environ | {"DASK_DISTRIBUTED__DASHBOARD__LINK": "", "PYTHONWARNINGS": "default"}

    def start(module: str, *words: str, log: Path) -> subprocess.Popen[bytes]:
        stream = stack.enter_context(log.open("wb"))
        command = [sys.executable, "-m", f"distributed.cli.dask_{module}", *words, "--no-dashboard"]
        process = subprocess.Popen(command, cwd=ROOT, stdout=stream, stderr=stream, env=environment)
        stack.callback(process.wait)
        stack.callback(process.kill)
        return process

    with ExitStack() as stack:
        start("scheduler", "--host", "127.0.0.1", "--port", "0", log=tmp_path / "scheduler.log")
        address = _awaited(tmp_path / "scheduler.log", r"Scheduler at:\s+(tcp://\S+)")
        logs = (tmp_path / "one.log", tmp_path / "two.log")
        workers = [start("worker", address, "--nthreads=1", "--no-nanny", log=log) for log in logs]
        for log in logs:
            _awaited(log, "(Registered to)")
        yield address, workers


def _awaited(log: Path, pattern: str) -> str:
    return str(until(lambda: re.search(pattern, log.read_text(encoding="utf-8")), f"{pattern} in {log}")[1])


def test_jobs_of_a_killed_worker_are_done_by_the_other_once(scheduler: tuple[str, list[subprocess.Popen[bytes]]], tmp_path: Path) -> None:
    address, workers = scheduler
    bad = str(dataset(tmp_path / "bad"))
    listed = [job(f"job{k}", tmp_path, source=bad, key=f"key{k}") for k in range(6)]
    program = (
        "import json, sys\n"
        "from rhizotwin.batches import cluster\n"
        "from rhizotwin.batches.jobs import Job\n"
        "listed = [Job(**plain) for plain in json.loads(sys.argv[2])]\n"
        "with cluster.connected(sys.argv[1], listed, say=lambda text: print(text, file=sys.stderr)) as client:\n"
        "    for job, outcome in cluster.run(listed, client):\n"
        "        print(job.name, outcome.state, outcome.sentence, flush=True)\n"
    )
    command = [sys.executable, "-c", program, address, json.dumps([one.plain() for one in listed])]
    running = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    time.sleep(1.5)  # the workers are loading what the first jobs need
    workers[0].send_signal(signal.SIGKILL)
    said, errors = running.communicate(timeout=180)
    assert running.returncode == 0, errors
    lines = sorted(said.splitlines())
    assert [line.split()[:2] for line in lines] == [[f"job{k}", "failed"] for k in range(6)]
    assert all("the picture is missing" in line for line in lines)
    assert workers[0].wait() == -signal.SIGKILL
