"""A batch of many plants under the conditions of a night in a laboratory: a worker is killed, a dataset is damaged.

Eighteen small scans of one sphere represent eighteen plants with different names: the batch is measured, not the
reconstruction.
"""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path

from benchmarks.run import Say
from rhizotwin.batches.jobs import RECORDS
from rhizotwin.scenes.files import load_scene

COUNT = 18
DAMAGED = 7
"""Number of the dataset of which half a picture is lost."""
SCENE, VIEWS, IMAGE_WH = "sphere_20mm", 24, (400, 300)
LOOK_S = 0.05
PARTIAL_S = 2.0
"""Processing time of the second scan at which its process is killed."""


@dataclass(frozen=True, kw_only=True)
class Night:
    """Result of a batch."""

    scans: int
    results: int
    sentences: tuple[str, ...]
    """Messages about failed scans."""
    twice: int
    """Number of scans reported as done more than once."""
    killed: int
    """Number of killed processes."""
    code: int
    """Exit code of the command."""
    wall_s: float
    jobs_s: float
    """Sum of the scans' times, including that of the killed process."""

    @property
    def own_s(self) -> float:
        """Seconds without work on a scan: loading libraries, writing table and page."""
        return self.wall_s - self.jobs_s

    def share(self, job_s: float) -> float:
        """Return the batch's fraction of the time, for scans of a given duration."""
        return self.own_s / (self.own_s + job_s * self.scans)


def measure(folder: Path, *, say: Say) -> Night:
    """Create the scans, start the batch with one worker, kill it once, and count the results."""
    _scans(folder / "scans", say)
    results = folder / "results"
    command = [sys.executable, "-m", "rhizotwin", "batch", str(folder / "scans"), "-o", str(results), "--workers", "1"]
    began = time.perf_counter()
    with (folder / "log").open("wb") as log:
        running = subprocess.Popen(command, stdout=log, stderr=log)
        _wait_for_one(results / RECORDS, running)
        time.sleep(PARTIAL_S)
        killed = _kill(running.pid)
        code = running.wait()
    wall_s = time.perf_counter() - began
    records = [json.loads(path.read_text(encoding="utf-8")) for path in sorted((results / RECORDS).glob("*.json"))]
    said = (folder / "log").read_text(encoding="utf-8").splitlines()
    return Night(
        scans=COUNT,
        results=len(list(results.glob("*/result.json"))),
        sentences=tuple(line for line in said if line.startswith("failed: ")),
        twice=sum(sum(f": plant_{number + 1:02d}: done" in line for line in said) > 1 for number in range(COUNT)),
        killed=killed,
        code=code,
        wall_s=wall_s,
        jobs_s=sum(record["seconds"] for record in records) + PARTIAL_S * killed,
    )


def _scans(folder: Path, say: Say) -> None:
    """Render one scan, and copy it for each plant."""
    from rhizotwin.sim.simulate import simulate

    scene = load_scene(SCENE)
    plan = replace(scene.plan, rings=tuple(replace(ring, views=VIEWS) for ring in scene.plan.rings))
    master = folder.with_name("master")
    if not (master / "dataset.json").is_file():
        say("rendering")
        simulate(replace(scene, plan=plan, camera=scene.camera.resized(IMAGE_WH)), master, profile_name="clean", seed=0)
    for number in range(COUNT):
        scan = folder / f"plant_{number + 1:02d}"
        shutil.copytree(master, scan)
        manifest = json.loads((scan / "dataset.json").read_text(encoding="utf-8"))
        manifest["scene"]["subject"] = {**manifest["scene"].get("subject", {}), "plant": scan.name, "day": 5.0}
        (scan / "dataset.json").write_text(json.dumps(manifest), encoding="utf-8")
    picture = sorted((folder / f"plant_{DAMAGED:02d}" / "images").iterdir())[0]
    picture.write_bytes(picture.read_bytes()[: picture.stat().st_size // 2])


def _wait_for_one(records: Path, running: "subprocess.Popen[bytes]") -> None:
    """Wait for the first record of a completed scan."""
    while running.poll() is None:
        if any(records.glob("*.json")):
            return
        time.sleep(LOOK_S)
    raise RuntimeError(f"the batch ended with code {running.returncode} before any scan was done")


def _kill(master: int) -> int:
    """Kill a batch's worker processes, and return their number."""
    listed = subprocess.run(["ps", "-o", "pid=,args=", "--ppid", str(master)], capture_output=True, text=True, check=False)
    workers = [int(line.split()[0]) for line in listed.stdout.splitlines() if "spawn_main" in line]
    for pid in workers:
        os.kill(pid, signal.SIGKILL)
    return len(workers)


def lines(night: Night, job_s: float) -> list[str]:
    """Return the results as lines of text."""
    return [
        f"{night.results} results of {night.scans} scans, {night.killed} process killed, {night.twice} done twice, exit code {night.code}",
        *night.sentences,
        f"{night.wall_s:.0f} s, of which {night.own_s:.1f} s overhead of the batch: {100.0 * night.own_s / night.wall_s:.1f} % here, "
        f"{100.0 * night.share(job_s):.1f} % with scans of {job_s:g} s",
    ]
