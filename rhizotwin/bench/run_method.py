"""Execution of a method on each case of a benchmark, and scoring of its output."""

from __future__ import annotations

import json
import os
import platform
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, replace
from importlib.metadata import version
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal

from rhizotwin.bench.benchmarks import Benchmark
from rhizotwin.bench.offers import CameraSource, offer
from rhizotwin.bench.outputs import score_outputs
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.formatting import printable
from rhizotwin.scenes.reading import read_file

SCHEMA = 1
BUILT_IN = ("ours", "thesis", "regularised", "hull")
State = Literal["done", "failed", "timeout", "nothing", "unreadable"]
TIMEOUT_S = 3600.0
_SMALL = """
import json, subprocess, sys
try:
    measured = {"exit_code": subprocess.call(sys.argv[2:])}
except OSError as error:
    sys.exit(f"{sys.argv[2]} cannot be started: {error.strerror}")
try:
    import resource
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    unit = 1024.0**2 if sys.platform == "darwin" else 1024.0  # bytes there, KiB elsewhere
    measured |= {"cpu_s": used.ru_utime + used.ru_stime, "memory_mib": used.ru_maxrss / unit}
except ImportError:
    pass
with open(sys.argv[1], "w", encoding="utf-8") as file:
    json.dump(measured, file)
"""
"""Helper process that starts the method, because Linux includes the parent in the peak memory of a process."""
_LAST_WORDS = 400
"""Maximum length of the quoted last error line of a failed method."""


@dataclass(frozen=True, kw_only=True)
class Row:
    """Outcome of one case."""

    case: str
    state: State
    """``nothing``: no file with a known name was written; ``unreadable``: none of them could be scored."""
    sentence: str = ""
    exit_code: int | None = None
    wall_s: float | None = None
    cpu_s: float | None = None
    """CPU time of all finished processes; None on systems that do not report it."""
    memory_mib: float | None = None
    """Peak memory of the largest process."""
    scores: dict[str, Any] = field(default_factory=dict)


def command_of(method: str) -> str:
    """Return the command line of a built-in method, or the given one.

    Raises
    ------
    UserError
        If a command has no ``{output}``, or is not a built-in method.
    """
    if method in BUILT_IN:
        return f"{shlex.quote(sys.executable)} -m rhizotwin reconstruct {{dataset}} -o {{output}} --method {method} --quiet"
    if "{output}" not in method:
        raise UserError(
            f"--method {printable(method)[:80]!r} is not a built-in method ({', '.join(BUILT_IN)}); a command line must contain "
            '{dataset} and {output}, such as --method "python my_method.py {dataset} {output}"'
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
    finished: Mapping[str, Row] = MappingProxyType({}),
    say: Callable[[Row], None] = lambda _: None,
) -> list[Row]:
    """Run a method on each case, in a folder without ground truth; failures are recorded in the rows.

    Parameters
    ----------
    benchmark : Benchmark
        Benchmark to run.
    folder : path
        Rendered datasets.
    method : str
        Command line as in `command_of`; ``{dataset}`` and ``{output}`` are replaced by paths.
    cameras : {"estimated", "true"}
        As in `offer`.
    timeout_s : float
        Time limit after which a case is stopped, including its child processes.
    keep : path, optional
        Folder in which the output of the method is kept, one subfolder per case.
    finished : mapping from str to Row
        Rows of an earlier run by case, which are reused.
    say : callable
        Receives each row.

    Returns
    -------
    list of Row
        Rows in the order of the cases.

    Raises
    ------
    UserError
        If a folder to be kept already exists.
    """
    command, rows = command_of(method), []
    for case in benchmark.cases:
        if keep is not None and case.name not in finished and (keep / case.name).exists():
            raise UserError(f"{keep / case.name} already exists; remove it, or choose another folder for --keep")
    for case in benchmark.cases:
        row = finished.get(case.name) or _run_case(case.name, folder / case.name, command, cameras, timeout_s, keep)
        rows.append(row)
        say(row)
    return rows


def score(benchmark: Benchmark, folder: Path, outputs: Path, *, say: Callable[[Row], None] = lambda _: None) -> list[Row]:
    """Score output that was written elsewhere, without times and memory.

    Parameters
    ----------
    benchmark : Benchmark
        Benchmark of the output.
    folder : path
        Rendered datasets.
    outputs : path
        Folder with one subfolder per case.
    say : callable
        Receives each row.
    """
    rows = []
    for case in benchmark.cases:
        there = (outputs / case.name).is_dir()
        row = Row(case=case.name, state="done" if there else "nothing", sentence="" if there else f"{outputs / case.name} does not exist")
        rows.append(_scored(row, outputs / case.name, folder / case.name))
        say(rows[-1])
    return rows


def as_json(benchmark: Benchmark, method: str, rows: list[Row], *, name: str, cameras: CameraSource | None) -> dict[str, Any]:
    """Return rows as JSON values, with the information needed to compare them with other results.

    Parameters
    ----------
    benchmark : Benchmark
        Benchmark of the rows.
    method, name : str
        Command line, and name of the method in tables.
    rows : list of Row
        Rows from `run` or `score`.
    cameras : str or None
        Cameras given to the method; None: unknown.
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


def finished_rows(path: Path, benchmark: Benchmark, method: str, *, cameras: CameraSource) -> dict[str, Row]:
    """Return the scored rows of an interrupted run of the same command.

    Parameters
    ----------
    path : path
        Results of the run.
    benchmark : Benchmark
        Benchmark to run.
    method, cameras : str
        As in `run`.

    Returns
    -------
    dict of Row
        Rows by case; empty without an interrupted run. A completed run is repeated, because the program behind the
        command may have changed.
    """
    try:
        stored = json.loads(read_file(path).decode("utf-8"))
        expected = (SCHEMA, benchmark.name, printable(method), cameras, version("rhizotwin"))
        if expected != (*(stored[name] for name in ("schema_version", "benchmark", "command", "cameras")), stored["versions"]["rhizotwin"]):
            return {}
        rows = [Row(**row) for row in stored["rows"]]
    except (UserError, KeyError, TypeError, ValueError, RecursionError):
        return {}
    is_complete = {row.case for row in rows} >= {case.name for case in benchmark.cases}
    return {} if is_complete else {row.case: row for row in rows if row.state == "done"}


def _run_case(case: str, dataset: Path, command: str, cameras: CameraSource, timeout_s: float, keep: Path | None) -> Row:
    """Run a method on a case and score its output, which is moved to ``keep`` when complete."""
    with tempfile.TemporaryDirectory(prefix="rhizotwin-bench-", ignore_cleanup_errors=True) as temporary:
        working = Path(temporary)
        offered, output = working / "dataset", working / "output"
        try:
            offer(dataset, offered, cameras=cameras)
        except UserError as error:
            return Row(case=case, state="failed", sentence=f"the method was not run: {error}")
        words = [word.replace("{dataset}", str(offered)).replace("{output}", str(output)) for word in shlex.split(command)]
        row = _scored(_run_once(case, words, working, timeout_s), output, dataset)
        if keep is not None and output.is_dir():
            keep.mkdir(parents=True, exist_ok=True)
            shutil.move(output, keep / case)
        return row


def _run_once(case: str, words: list[str], working: Path, timeout_s: float) -> Row:
    """Run a command in its own process group and measure it."""
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
            return Row(
                case=case, state="timeout", sentence=f"stopped at the time limit of {timeout_s:g} s", wall_s=time.perf_counter() - began
            )
        finally:
            _end(child)  # with its child processes
            child.wait()
        errors.seek(0)
        last = errors.read().decode(errors="replace").strip().splitlines()
    measured = json.loads(used.read_text(encoding="utf-8")) if used.is_file() else {}
    code = measured.get("exit_code", child.returncode)
    cause = f": {printable(last[-1])[:_LAST_WORDS]}" if last else ""
    return Row(
        case=case,
        state="failed" if code else "done",
        sentence=f"exited with code {code}{cause}" if code else "",
        exit_code=code,
        wall_s=time.perf_counter() - began,
        cpu_s=measured.get("cpu_s"),
        memory_mib=measured.get("memory_mib"),
    )


def _end(child: subprocess.Popen[bytes]) -> None:
    """Terminate a process and its group."""
    try:
        if hasattr(os, "killpg"):
            os.killpg(child.pid, signal.SIGKILL)
        elif child.poll() is None:
            child.kill()
    except (ProcessLookupError, PermissionError):
        pass


def _scored(row: Row, output: Path, dataset: Path) -> Row:
    """Return a row with the scores of the output."""
    if row.state != "done":
        return row
    scores, sentences = score_outputs(output, dataset)
    sentences = [sentence.replace(f"{output}{os.sep}", "") for sentence in sentences]
    state: State = "done" if scores else "unreadable" if sentences else "nothing"
    sentence = "; ".join(sentences) or ("" if scores else "no output file with a known name (see docs/benchmark.md)")
    return replace(row, state=state, sentence=sentence, scores=scores)
