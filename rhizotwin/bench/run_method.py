"""Run a method's command line on every case of a benchmark, and score what it leaves."""

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

from rhizotwin.bench.named import Benchmark
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
    finished: Mapping[str, Row] = MappingProxyType({}),
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
    finished : mapping from str to Row
        Rows of an earlier run by case, which are taken over.
    say : callable
        Hears every row.

    Returns
    -------
    list of Row
        In the order of the cases.

    Raises
    ------
    UserError
        Where a folder that would be kept exists already.
    """
    command, rows = command_of(method), []
    for case in benchmark.cases:
        if keep is not None and case.name not in finished and (keep / case.name).exists():
            raise UserError(f"{keep / case.name} exists already; remove it, or choose another folder for what the method writes")
    for case in benchmark.cases:
        row = finished.get(case.name) or _run_case(case.name, folder / case.name, command, cameras, timeout_s, keep)
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


def finished_rows(path: Path, benchmark: Benchmark, method: str, *, cameras: CameraSource) -> dict[str, Row]:
    """Return the rows with scores of a run of the same command that was stopped before its last case.

    Parameters
    ----------
    path : path
        Its results.
    benchmark : Benchmark
        What is run.
    method, cameras : str
        As in `run`.

    Returns
    -------
    dict of Row
        By case; empty where there was no such run. A run that came to its end is not gone on with: the program behind
        the command may have changed.
    """
    try:
        stored = json.loads(read_file(path).decode("utf-8"))
        asked = (SCHEMA, benchmark.name, printable(method), cameras, version("rhizotwin"))
        if asked != (*(stored[name] for name in ("schema_version", "benchmark", "command", "cameras")), stored["versions"]["rhizotwin"]):
            return {}
        rows = [Row(**row) for row in stored["rows"]]
    except (UserError, KeyError, TypeError, ValueError, RecursionError):
        return {}
    is_complete = {row.case for row in rows} >= {case.name for case in benchmark.cases}
    return {} if is_complete else {row.case: row for row in rows if row.state == "done"}


def _run_case(case: str, dataset: Path, command: str, cameras: CameraSource, timeout_s: float, keep: Path | None) -> Row:
    """Run a method on a case and score what it wrote; this is moved to ``keep`` only when it is complete."""
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
