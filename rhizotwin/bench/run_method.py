"""Run a method's command line on every case of a benchmark, and score what it leaves."""

from __future__ import annotations

import json
import os
import platform
import shlex
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal

from rhizotwin.bench.named import Benchmark
from rhizotwin.bench.offers import CameraSource, offer
from rhizotwin.bench.outputs import score_outputs
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.said import printable

SCHEMA = 1
BUILT_IN = ("ours", "thesis", "hull")
State = Literal["done", "failed", "timeout", "nothing", "unreadable"]
TIMEOUT_S = 3600.0
_SMALL = """
import json, subprocess, sys
try:
    told = {"exit_code": subprocess.call(sys.argv[2:])}
except OSError as error:
    sys.exit(f"{sys.argv[2]} cannot be started: {error.strerror}")
try:
    import resource
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    unit = 1024.0**2 if sys.platform == "darwin" else 1024.0  # bytes there, KiB elsewhere
    told |= {"cpu_s": used.ru_utime + used.ru_stime, "memory_mib": used.ru_maxrss / unit}
except ImportError:
    pass
with open(sys.argv[1], "w", encoding="utf-8") as file:
    json.dump(told, file)
"""
"""Between us and the method: Linux counts the memory of whoever starts a process as the process's own peak."""
_LAST_WORDS = 400
"""Characters of a failed method's last line of errors that are kept."""


@dataclass(frozen=True, kw_only=True)
class Row:
    """What became of one case."""

    case: str
    state: State
    """``nothing``: no file with a known name was left; ``unreadable``: none of them could be scored."""
    sentence: str = ""
    exit_code: int | None = None
    wall_s: float | None = None
    cpu_s: float | None = None
    """Of all processes that ended; None on systems that do not count it."""
    memory_mib: float | None = None
    """Of the largest process."""
    scores: dict[str, Any] = field(default_factory=dict)


def command_of(method: str) -> str:
    """Return the command line of a built-in method, or the one that was given.

    Raises
    ------
    UserError
        Where a command has no ``{output}``, or is no built-in method.
    """
    if method in BUILT_IN:
        return f"{shlex.quote(sys.executable)} -m rhizotwin reconstruct {{dataset}} -o {{output}} --method {method} --quiet"
    if "{output}" not in method:
        raise UserError(
            f"--method {printable(method)[:80]!r} is none of {', '.join(BUILT_IN)}; a command line needs {{dataset}} and {{output}}, "
            'such as --method "python my_method.py {dataset} {output}"'
        )
    return method


def run(
    benchmark: Benchmark,
    folder: Path,
    method: str,
    *,
    cameras: CameraSource = "estimated",
    timeout_s: float = TIMEOUT_S,
    keep: Path | None = None,
    say: Callable[[Row], None] = lambda _: None,
) -> list[Row]:
    """Run a method on each case, in a folder that holds no truth; a case that goes wrong is a row that says so.

    Parameters
    ----------
    benchmark : Benchmark
        Its cases.
    folder : path
        Where `make` rendered them.
    method : str
        As `command_of` takes it; ``{dataset}`` and ``{output}`` become paths.
    cameras : {"estimated", "true"}
        As in `offer`.
    timeout_s : float
        After which a case is stopped, with all that it started.
    keep : path, optional
        Folder for what the method wrote, a folder a case.
    say : callable
        Hears every row.

    Returns
    -------
    list of Row
        In the order of the cases.
    """
    command, rows = command_of(method), []
    for case in benchmark.cases:
        dataset = folder / case.name
        with _working(keep, case.name) as (working, output):
            offered = working / "dataset"
            offer(dataset, offered, cameras=cameras)
            words = [word.replace("{dataset}", str(offered)).replace("{output}", str(output)) for word in shlex.split(command)]
            row = _scored(_run_once(case.name, words, working, timeout_s), output, dataset)
        rows.append(row)
        say(row)
    return rows


def score(benchmark: Benchmark, folder: Path, outputs: Path, *, say: Callable[[Row], None] = lambda _: None) -> list[Row]:
    """Score outputs that were made elsewhere, without times and memory.

    Parameters
    ----------
    benchmark : Benchmark
        Its cases.
    folder : path
        Where `make` rendered them.
    outputs : path
        A folder for each case.
    say : callable
        Hears every row.
    """
    rows = []
    for case in benchmark.cases:
        there = (outputs / case.name).is_dir()
        row = Row(case=case.name, state="done" if there else "nothing", sentence="" if there else f"{outputs / case.name} does not exist")
        rows.append(_scored(row, outputs / case.name, folder / case.name))
        say(rows[-1])
    return rows


def as_json(benchmark: Benchmark, method: str, rows: list[Row], *, name: str, cameras: CameraSource | None) -> dict[str, Any]:
    """Return rows with all that is needed to compare them with those of others, as JSON values.

    Parameters
    ----------
    benchmark : Benchmark
        What was run.
    method, name : str
        The command line, and the method's name in tables.
    rows : list of Row
        As `run` or `score` gives them.
    cameras : str or None
        Which cameras were offered; None: not known.
    """
    return {
        "schema_version": SCHEMA,
        "benchmark": benchmark.name,
        "method": name,
        "command": printable(method),
        "cameras": cameras,
        "versions": {"rhizotwin": version("rhizotwin"), "python": platform.python_version()},
        "machine": {"system": platform.system(), "processor": platform.machine(), "cores": os.cpu_count()},
        "rows": [asdict(row) for row in rows],
    }


@contextmanager
def _working(keep: Path | None, case: str) -> Iterator[tuple[Path, Path]]:
    """Yield a folder to work in and the one to write into, which is kept where that is wanted."""
    with tempfile.TemporaryDirectory(prefix="rhizotwin-bench-", ignore_cleanup_errors=True) as temporary:
        output = Path(temporary) / "output" if keep is None else keep.resolve() / case
        if output.exists():
            raise UserError(f"{output} exists already; choose another folder for what the method writes")
        output.parent.mkdir(parents=True, exist_ok=True)
        yield Path(temporary), output


def _run_once(case: str, words: list[str], working: Path, timeout_s: float) -> Row:
    """Run a command in its own group of processes and measure it."""
    used, began = working / "used.json", time.perf_counter()
    with (working / "errors.txt").open("w+b") as errors:
        child = subprocess.Popen(
            [sys.executable, "-I", "-c", _SMALL, str(used), *words],
            stdin=subprocess.DEVNULL,
            stdout=errors,
            stderr=errors,
            start_new_session=True,
        )
        try:
            child.wait(timeout_s)
        except subprocess.TimeoutExpired:
            return Row(case=case, state="timeout", sentence=f"stopped after {timeout_s:g} s", wall_s=time.perf_counter() - began)
        finally:
            _end(child)  # with what it left running
            child.wait()
        errors.seek(0)
        last = errors.read().decode(errors="replace").strip().splitlines()
    told = json.loads(used.read_text(encoding="utf-8")) if used.is_file() else {}
    code = told.get("exit_code", child.returncode)
    cause = f": {printable(last[-1])[:_LAST_WORDS]}" if last else ""
    return Row(
        case=case,
        state="failed" if code else "done",
        sentence=f"ended with code {code}{cause}" if code else "",
        exit_code=code,
        wall_s=time.perf_counter() - began,
        cpu_s=told.get("cpu_s"),
        memory_mib=told.get("memory_mib"),
    )


def _end(child: subprocess.Popen[bytes]) -> None:
    """End a process with all of its group."""
    try:
        if hasattr(os, "killpg"):
            os.killpg(child.pid, signal.SIGKILL)
        elif child.poll() is None:
            child.kill()
    except (ProcessLookupError, PermissionError):
        pass


def _scored(row: Row, output: Path, dataset: Path) -> Row:
    """Return a row with the scores of what was written."""
    if row.state != "done":
        return row
    scores, sentences = score_outputs(output, dataset)
    sentences = [sentence.replace(f"{output}{os.sep}", "") for sentence in sentences]
    state: State = "done" if scores else "unreadable" if sentences else "nothing"
    sentence = "; ".join(sentences) or ("" if scores else "wrote no file with a known name (docs/benchmark.md lists them)")
    return replace(row, state=state, sentence=sentence, scores=scores)
