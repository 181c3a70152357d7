"""Check of `rhizotwin batch --cluster slurm` on a real cluster of one node, which is started on this computer.

Six small scans are reconstructed: one Slurm job is cancelled while it runs, and another one gets too little memory. All
six results must exist, and each loss must be reported. On Debian, Slurm is installed by ``apt-get install slurmctld
slurmd slurm-client munge``. All programs of the cluster listen on 127.0.0.1 only, and are ended with the check.
"""

import argparse
import getpass
import io
import os
import shutil
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, redirect_stderr
from dataclasses import replace
from pathlib import Path
from typing import TextIO

from rhizotwin.batches import collect, slurm
from rhizotwin.batches.jobs import Job
from rhizotwin.batches.run import Batch, run
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.memory import total_mib

COUNT = 6
PROGRAMS = ("slurmctld", "slurmd", "sbatch", "squeue", "munged")
TOO_FEW_PIXELS = -4e6
"""Number of pixels for which 420 MiB are predicted. A small scan needs 890 MiB, less than twice the request."""
CONFIGURATION = """
ClusterName=check
SlurmctldHost={host}(127.0.0.1)
SlurmUser={user}
SlurmdUser={user}
AuthType=auth/munge
AuthInfo=socket={folder}/munge/socket
SlurmctldPort={ports[0]}
SlurmdPort={ports[1]}
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/slurmd.pid
SlurmctldLogFile={folder}/slurmctld.log
SlurmdLogFile={folder}/slurmd.log
StateSaveLocation={folder}/state
SlurmdSpoolDir={folder}/spool
ProctrackType=proctrack/pgid
TaskPlugin=task/none
MpiDefault=none
ReturnToService=2
SelectType=select/cons_tres
SelectTypeParameters=CR_Core_Memory
JobAcctGatherType=jobacct_gather/linux
JobAcctGatherFrequency=task=1
JobAcctGatherParams=OverMemoryKill
CommunicationParameters=NoInAddrAny
NodeName={host} NodeAddr=127.0.0.1 CPUs={processors} RealMemory={memory_mib}
PartitionName=all Nodes=ALL Default=YES MaxTime=60 DefaultTime=60 State=UP
"""


@contextmanager
def cluster(folder: Path) -> Iterator[None]:
    """Start a cluster of one node whose files are in a folder, and end it afterwards."""
    munge = folder / "munge"
    for name in ("munge", "state", "spool"):
        (folder / name).mkdir()
    (munge / "key").write_bytes(os.urandom(1024))
    (munge / "key").chmod(0o400)
    as_munge: list[str] = []
    if os.getuid() == 0:  # munged refuses a key of somebody else
        as_munge = ["runuser", "-u", "munge", "--"]
        for path in (munge, munge / "key"):
            shutil.chown(path, "munge", "munge")
    munge.chmod(0o711)
    folder.chmod(0o711)
    with ExitStack() as opened:
        sockets = [opened.enter_context(socket.socket()) for _ in range(2)]
        for one in sockets:
            one.bind(("127.0.0.1", 0))
        ports = [one.getsockname()[1] for one in sockets]
    host = socket.gethostname().partition(".")[0]
    values = {"host": host, "user": getpass.getuser(), "folder": folder, "ports": ports, "processors": os.cpu_count()}
    (folder / "slurm.conf").write_text(CONFIGURATION.format(**values, memory_mib=int(0.8 * total_mib())), encoding="utf-8")
    os.environ["SLURM_CONF"] = str(folder / "slurm.conf")
    words = [
        f"--{name}={munge / path}"
        for name, path in {"key-file": "key", "socket": "socket", "pid-file": "pid", "log-file": "log", "seed-file": "seed"}.items()
    ]
    with ExitStack() as running:
        for command in ([*as_munge, "munged", "--foreground", *words], ["slurmctld", "-D"], ["slurmd", "-D"]):
            log = running.enter_context((folder / "programs.log").open("ab"))
            process = subprocess.Popen(command, stdout=log, stderr=log)
            running.callback(process.wait)
            running.callback(process.terminate)
            time.sleep(1.0)
        _wait_for(lambda: "idle" in _output("sinfo", "-h", "-o", "%T"), "the node")
        yield


def check(folder: Path, out: TextIO) -> list[str]:
    """Run the six scans, and return what is wrong."""
    words = ("simulate", "sphere_20mm", "--views", "4", "--image-wh", "200x150", "-o", str(folder / "scan"), "--quiet")
    subprocess.run([sys.executable, "-m", "rhizotwin", *words], check=True)
    for number in range(COUNT):
        shutil.copytree(folder / "scan", folder / "scans" / f"plant_{number + 1}")
    jobs = collect.reconstructions([str(folder / "scans")], str(folder / "results"), voxel_mm=None, settings=None, device="cpu")
    jobs[-1] = replace(jobs[-1], pixels=TOO_FEW_PIXELS)
    threading.Thread(target=_cancel, args=(jobs[1],), daemon=True).start()
    said = io.StringIO()
    began_s = time.monotonic()
    with redirect_stderr(_Tee(said, out)):
        made = run(jobs, str(folder / "results"), cluster="slurm")
    out.write(f"{len(made.done)} of {COUNT} scans in {time.monotonic() - began_s:.0f} s\n")
    return _wrong(made, jobs, said.getvalue().splitlines())


def _wrong(made: Batch, jobs: list[Job], lines: list[str]) -> list[str]:
    told = {jobs[1].name: "ended by Slurm (CANCELLED)", jobs[-1].name: "it needed more than the requested 525 MiB"}
    wrong = [f"{job.name} has no result" for job in jobs if not (Path(job.output) / "result.json").is_file()]
    wrong += [f"{job.name} failed: {sentence}" for job, sentence in made.failed]
    said = [*told.items(), *((job.name, " runs on ") for job in jobs)]
    wrong += [
        f"'{text}' was not said of {name}" for name, text in said if not any(line.startswith(name) and text in line for line in lines)
    ]
    return wrong


class _Tee(io.StringIO):
    def __init__(self, *outs: TextIO) -> None:
        super().__init__()
        self._outs = outs

    def write(self, text: str) -> int:
        for out in self._outs:
            out.write(text)
            out.flush()
        return len(text)


def _cancel(job: Job) -> None:
    """Cancel the first Slurm job of a scan while it runs."""
    name = slurm._name(job)
    number = _wait_for(lambda: _output("squeue", "-h", "-t", "RUNNING", "-n", name, "-o", "%i").strip(), job.name)
    _output("scancel", number)


def _wait_for(look: Callable[[], str | bool], what: str) -> str:
    for _ in range(600):
        if found := look():
            return str(found)
        time.sleep(0.5)
    raise UserError(f"{what} did not appear within 5 min")


def _output(*words: str) -> str:
    return subprocess.run(words, capture_output=True, text=True, check=False).stdout


def main() -> int:
    """Start the cluster, run the check, and return the exit code: 0 passed, 1 failed, 2 not possible."""
    parser = argparse.ArgumentParser(prog="./run slurm", description=__doc__)
    parser.parse_args()
    missing = [name for name in PROGRAMS if shutil.which(name) is None]
    if missing:
        packages = "slurmctld slurmd slurm-client munge"
        sys.stderr.write(f"{', '.join(missing)} not found; install Slurm, on Debian: sudo apt-get install {packages}\n")
        return 2
    with tempfile.TemporaryDirectory(prefix="slurm-check-") as name:
        folder = Path(name)
        try:
            with cluster(folder):
                wrong = check(folder, sys.stdout)
        except (UserError, OSError) as error:
            wrong = [str(error)]
        for log in folder.glob("*.log") if wrong else ():
            sys.stdout.write(f"{log.name}:\n{log.read_text(encoding='utf-8', errors='replace')[-2000:]}\n")
    sys.stdout.write("".join(f"WRONG: {one}\n" for one in wrong) or "passed\n")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
