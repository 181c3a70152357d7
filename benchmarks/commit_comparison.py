"""Processor time and memory of commands, and their comparison with another commit on the same machine at the same time.

The other commit is checked out as a git worktree in the cache, and run with the same Python and libraries. Runs
alternate, and only the command line must be the same in both, so that old commits can be compared. Processor time is
that of all threads of the child processes; wall time on a shared machine mostly depends on other processes. Peak memory
is at least that of this process (about 140 MiB): Linux counts a child's memory before it executes another program.
"""

from __future__ import annotations

import os
import shutil
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from benchmarks import cache, masks_in_air
from benchmarks.output import markdown
from benchmarks.run import Say
from rhizotwin.scenes.errors import UserError

ROOT = Path(__file__).resolve().parent.parent
_SMALL = """
import resource, subprocess, sys
code = subprocess.call(sys.argv[1:], stdout=subprocess.DEVNULL)
used = resource.getrusage(resource.RUSAGE_CHILDREN)
print(used.ru_utime + used.ru_stime, used.ru_maxrss)
sys.exit(code)
"""
"""Intermediate process for measurements: Linux counts the memory of the starting process as a peak of the child."""
SET = "SET"
"""Placeholder for the folder of a job's pictures in its arguments."""
LAST_WORDS = 2000
"""Length of a failed run's error text that is reported."""


@dataclass(frozen=True)
class Job:
    """A command line that is run by both commits."""

    name: str
    words: tuple[str, ...]
    makes: bool = True
    """Whether it writes a folder given by ``-o``."""
    pictures: tuple[str, ...] = ()
    """Arguments of ``simulate`` for the pictures of `SET`; the other commit renders them, as the newer one can read
    them."""
    must: float | None = None
    """Required ratio of processor times."""


def _set(scene: str, views: int, *words: str) -> tuple[str, ...]:
    return (scene, "--views", str(views), *words)


IN_AIR = ("masks-in-air",)
"""Alternative to arguments of ``simulate``: `masks_in_air`."""

JOBS = (
    Job("printed-0.27", ("reconstruct", SET), pictures=_set("printed_8ml", 40), must=0.22),
    Job("printed-0.07", ("reconstruct", SET, "--voxel-mm", "0.07"), pictures=_set("printed_8ml", 40), must=0.3),
    Job("radish_day15b", ("reconstruct", SET), pictures=_set("radish_day15b", 80), must=0.3),
    Job("bean", ("reconstruct", SET), pictures=_set("bean", 80), must=0.3),
    Job("radish_day30c", ("reconstruct", SET), pictures=_set("radish_day30c", 80), must=0.3),
    Job("simulate", ("simulate", "radish_day15b", "--views", "80"), must=0.7),
    Job("simulate-path", ("simulate", "radish_day15b", "--views", "4", "--fidelity", "path"), must=0.7),
    Job("masks-in-air", ("reconstruct", SET, "--voxel-mm", "0.4"), pictures=IN_AIR, must=0.15),
    Job("six-megapixels", ("reconstruct", SET), pictures=_set("radish_day15b", 80, "--image-wh", "2028x1520"), must=0.4),
    Job("demo", ("demo",), must=0.41),
    Job("help", ("--help",), makes=False),
)
QUICK = (
    Job("simulate-quick", ("simulate", "radish_day15b", "--views", "6"), must=0.25),
    Job("printed-quick", ("reconstruct", SET), pictures=(*_set("printed_8ml", 20), "--image-wh", "400x300"), must=0.333),
    Job("help", ("--help",), makes=False),
)


@dataclass(frozen=True, kw_only=True)
class Used:
    """Cost of one run."""

    cpu_s: float
    wall_s: float
    memory_mib: float


@dataclass(frozen=True, kw_only=True)
class Ratio:
    """Ratio of a job's cost to that of the other commit."""

    job: str
    runs: int
    cpu: float
    """Median over the pairs of the ratio of processor times."""
    memory: float
    """Median over the pairs of the ratio of peak memories."""
    before: Used
    """Median costs of the other commit; those of this code if there is no other."""
    after: Used
    must: float | None


def compare(commit: str | None, *, jobs: Sequence[Job], repeats: int, device: str, say: Say) -> list[Ratio]:
    """Alternate runs of another commit and of this code, or run this code only.

    Parameters
    ----------
    commit : str or None
        Other commit, as a git revision; None to run this code only.
    jobs : sequence of Job
        Jobs run by both.
    repeats : int
        Pairs of runs per job.
    device : str
        Computing device.
    say : Say
        Receives the progress.

    Returns
    -------
    list of Ratio
        Ratios of this code's processor time and memory to the other's.

    Raises
    ------
    UserError
        If git does not know the commit, or a run fails.
    """
    other = ROOT if commit is None else check_out(commit)
    found = []
    for job in jobs:
        with tempfile.TemporaryDirectory(prefix="rhizotwin-against-") as working:
            words = [_pictures(job, other, device=device) if word == SET else word for word in job.words]
            pairs: list[tuple[Used, Used]] = []
            for number in range(repeats):
                once: list[Used] = []
                for root in (ROOT,) if commit is None else (other, ROOT) if number % 2 == 0 else (ROOT, other):
                    out = Path(working) / f"{number}-{len(once)}"
                    once.append(run_once(root, [*words, *(("-o", str(out), "--device", device) if job.makes else ())]))
                    shutil.rmtree(out, ignore_errors=True)
                pairs.append((once[0], once[-1]) if number % 2 == 0 else (once[-1], once[0]))
        found.append(_ratio(job, pairs))
        say(table(found[-1:]).splitlines()[-1])
    return found


def check_out(commit: str) -> Path:
    """Return a folder with a checkout of a commit, created if it is not in the cache."""
    try:
        done = subprocess.run(
            ["git", "rev-parse", "--verify", f"{commit}^{{commit}}"], cwd=ROOT, capture_output=True, text=True, check=True
        )
        name = done.stdout.strip()
        folder = cache.folder() / "commits" / name
        if not folder.is_dir():
            folder.parent.mkdir(parents=True, exist_ok=True)
            subprocess.run(["git", "worktree", "prune"], cwd=ROOT, capture_output=True, check=True)
            subprocess.run(["git", "worktree", "add", "--detach", str(folder), name], cwd=ROOT, capture_output=True, text=True, check=True)
    except FileNotFoundError:
        raise UserError("git is not installed, but --against requires it") from None
    except subprocess.CalledProcessError as error:
        raise UserError(f"--against {commit}: git says {str(error.stderr).strip()!r}") from None
    return folder


def _pictures(job: Job, root: Path, *, device: str) -> str:
    """Return the folder of a job's pictures, rendered once by the other commit."""
    folder = cache.folder() / "against" / f"{root.name[:12]}-{'-'.join(job.pictures).replace('--', '')}"
    if not (folder / "dataset.json").is_file():
        folder.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix="rhizotwin-in-air-") as working:
            words = masks_in_air.write(Path(working)) if job.pictures == IN_AIR else ("simulate", *job.pictures, "--device", device)
            run_once(root, [*words, "-o", str(folder)])
    return str(folder)


def run_once(root: Path, words: Sequence[str]) -> Used:
    """Run a command line of a checkout in its own process."""
    began = time.perf_counter()
    with tempfile.TemporaryFile() as errors:
        child = subprocess.Popen(
            [sys.executable, "-c", _SMALL, sys.executable, "-m", "rhizotwin", *words],
            cwd=root,
            env={**os.environ, "PYTHONPATH": str(root)},
            stdout=subprocess.PIPE,
            stderr=errors,
            start_new_session=True,
        )
        try:
            said, _ = child.communicate()
        except BaseException:
            os.killpg(child.pid, signal.SIGKILL)
            child.wait()
            raise
        if child.returncode != 0:
            errors.seek(0)
            last = errors.read().decode(errors="replace")[-LAST_WORDS:]
            raise UserError(f"`rhizotwin {' '.join(words)}` of {root} ended with code {child.returncode}: {last}")
    cpu_s, peak = (float(word) for word in said.split()[-2:])
    unit = 1024.0**2 if sys.platform == "darwin" else 1024.0  # bytes on macOS, KiB elsewhere
    return Used(cpu_s=cpu_s, wall_s=time.perf_counter() - began, memory_mib=peak / unit)


def _ratio(job: Job, pairs: Sequence[tuple[Used, Used]]) -> Ratio:
    before, after = ([pair[k] for pair in pairs] for k in (0, 1))
    return Ratio(
        job=job.name,
        runs=len(pairs),
        cpu=statistics.median(b.cpu_s / a.cpu_s for a, b in pairs),
        memory=statistics.median(b.memory_mib / a.memory_mib for a, b in pairs),
        before=_middle(before),
        after=_middle(after),
        must=job.must,
    )


def _middle(runs: Sequence[Used]) -> Used:
    return Used(**{name: statistics.median(asdict(run)[name] for run in runs) for name in ("cpu_s", "wall_s", "memory_mib")})


def table(ratios: Sequence[Ratio]) -> str:
    """Return ratios as a Markdown table."""
    rows = []
    for r in ratios:
        must = "" if r.must is None else f"{r.must:.2f}"
        times, memories = f"{r.before.cpu_s:.1f} -> {r.after.cpu_s:.1f}", f"{r.before.memory_mib:.0f} -> {r.after.memory_mib:.0f}"
        rows.append((r.job, f"{r.runs}", f"{r.cpu:.2f}", must, f"{r.memory:.2f}", times, memories))
    return markdown("job | pairs | processor time | must | memory | processor s | memory MiB", rows)
