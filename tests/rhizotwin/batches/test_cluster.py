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
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

from rhizotwin.batches import cluster
from rhizotwin.batches.jobs import Job
from rhizotwin.scenes.dataset import Dataset, Frame, save_dataset
from rhizotwin.scenes.model import Scene

ROOT = Path(__file__).resolve().parents[3]
COUNT = 6


@pytest.fixture
def scheduler(tmp_path: Path) -> Iterator[tuple[str, list[subprocess.Popen[bytes]]]]:
    """Return a scheduler's address and its two workers."""
    pytest.importorskip("distributed")
    environment = os.environ | {"DASK_DISTRIBUTED__DASHBOARD__LINK": "", "PYTHONWARNINGS": "default"}

    def start(*words: str, log: str) -> subprocess.Popen[bytes]:
        stream = stack.enter_context((tmp_path / log).open("wb"))
        command = [sys.executable, "-m", "distributed.cli.dask_" + words[0], *words[1:]]
        process = subprocess.Popen(command, cwd=ROOT, stdout=stream, stderr=stream, env=environment)
        stack.callback(process.wait)
        stack.callback(process.kill)
        return process

    with ExitStack() as stack:
        start("scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard", log="scheduler.log")
        address = _awaited(tmp_path / "scheduler.log", r"Scheduler at:\s+(tcp://\S+)")
        workers = [start("worker", address, "--nthreads=1", "--no-nanny", "--no-dashboard", log=f"{name}.log") for name in ("one", "two")]
        for name in ("one", "two"):
            _awaited(tmp_path / f"{name}.log", "(Registered to)")
        yield address, workers


def _awaited(log: Path, pattern: str) -> str:
    for _ in range(600):
        found = re.search(pattern, log.read_text(encoding="utf-8")) if log.exists() else None
        if found:
            return found[1]
        time.sleep(0.1)
    raise AssertionError(log.read_text(encoding="utf-8"))


def test_what_a_killed_worker_did_is_done_by_the_other_and_nothing_twice(
    scheduler: tuple[str, list[subprocess.Popen[bytes]]], tmp_path: Path
) -> None:
    address, workers = scheduler
    bad = tmp_path / "bad"
    save_dataset(Dataset(folder=bad, scene=Scene(), frames=(Frame(file="images/a.png", sha256=""),)))
    options = {"voxel_mm": None, "settings": None, "device": "cpu"}
    plain = Job(name="", kind="reconstruct", source=str(bad), output="", key="", pixels=1.0, options=options)
    outputs = {f"job{k}": str(tmp_path / "r" / f"job{k}") for k in range(COUNT)}
    listed = [replace(plain, name=name, output=output, key=name * 3) for name, output in outputs.items()]
    program = tmp_path / "batch.py"
    program.write_text(
        "import json, sys\n"
        "from rhizotwin.batches import cluster\n"
        "from rhizotwin.batches.jobs import Job\n"
        "listed = [Job(**plain) for plain in json.loads(open(sys.argv[2]).read())]\n"
        "with cluster.connected(sys.argv[1], listed, workers=None) as client:\n"
        "    for job, outcome in cluster.run(listed, client):\n"
        "        print(job.name, outcome.state, outcome.sentence, flush=True)\n",
        encoding="utf-8",
    )
    (tmp_path / "jobs.txt").write_text(json.dumps([job.plain() for job in listed]), encoding="utf-8")
    command = [sys.executable, str(program), address, str(tmp_path / "jobs.txt")]
    running = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    time.sleep(1.5)  # the workers are loading what the first jobs need
    workers[0].send_signal(signal.SIGKILL)
    said, errors = running.communicate(timeout=180)
    assert running.returncode == 0, errors
    lines = sorted(said.splitlines())
    assert [line.split()[:2] for line in lines] == [[f"job{k}", "failed"] for k in range(COUNT)]
    assert all("the picture is missing" in line for line in lines)
    assert workers[0].wait() == -signal.SIGKILL


def test_two_batches_on_one_scheduler_have_jobs_of_their_own() -> None:
    outputs: dict[str, str] = {}

    def submit(_: object, plain: dict[str, str], *, key: str, pure: bool) -> None:
        assert not pure
        outputs.setdefault(key, plain["output"])  # Dask runs one of several tasks with equal keys

    for output in ("r/one", "other/one"):
        one = Job(name="one", kind="reconstruct", source="s", output=output, key="k", pixels=1.0, options={})
        cluster._submit(SimpleNamespace(submit=submit), one, 1)
    assert sorted(outputs.values()) == ["other/one", "r/one"]


def test_slurm_asks_for_the_memory_of_the_largest_job(tmp_path: Path) -> None:
    pytest.importorskip("dask_jobqueue")
    program = (
        "from pathlib import Path; from rhizotwin.batches import cluster; from rhizotwin.batches.jobs import Job\n"
        "if __name__ == '__main__':\n"
        "    one = Job(name='a', kind='reconstruct', source='s', output='o', key='k', pixels=20e6, options={})\n"
        "    with cluster.slurm([one]) as made: print(made.job_script())\n"
    )
    (tmp_path / "ask.py").write_text(program, encoding="utf-8")
    done = subprocess.run([sys.executable, str(tmp_path / "ask.py")], capture_output=True, text=True, timeout=120, check=True)
    assert "#SBATCH --mem=4G" in done.stdout  # 700 + 120 * 20 = 3100 MiB, in whole GB as SLURM is asked
