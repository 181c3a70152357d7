"""Execution of a reconstruction method on each case of a benchmark, and scoring of its output."""

from __future__ import annotations

import json
import os
import platform
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass, field, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal

from rhizotwin.bench import supervisor
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
_LAST_WORDS = 400
"""Maximum number of characters that are quoted from the last line of output if a method fails."""


@dataclass(frozen=True, kw_only=True)
class Row:
    """Outcome of a method on one case."""

    case: str
    state: State
    """``done``, ``failed``, ``timeout``, ``nothing`` (no file with a known name was written) or ``unreadable`` (no file
    could be scored)."""
    sentence: str = ""
    """Reason for a state other than ``done``, or for files that could not be scored."""
    exit_code: int | None = None
    wall_s: float | None = None
    cpu_s: float | None = None
    """Total CPU time of all finished processes, in seconds. It is None if the operating system does not report CPU
    time."""
    memory_mib: float | None = None
    """Peak memory of the largest process, in MiB. It is None if the operating system does not report it."""
    scores: dict[str, Any] = field(default_factory=dict)


def command_of(method: str, *, cameras: CameraSource = "estimated") -> str:
    """Return the command line of a method.

    ``method`` is the name of a built-in method, or already a command line.

    Raises
    ------
    UserError
        If ``method`` is neither a built-in method nor a command line that contains ``{output}``, or a built-in method,
        which estimates its cameras itself, is to be run with true cameras.
    """
    if method in BUILT_IN and cameras == "true":
        raise UserError(f"--cameras true cannot be used with --method {method}, which estimates its cameras itself; remove --cameras true")
    if method in BUILT_IN:
        return f"{shlex.quote(sys.executable)} -m rhizotwin reconstruct {{dataset}} -o {{output}} --method {method} --quiet"
    if "{output}" not in method:
        raise UserError(
            f"--method {printable(method)[:80]!r} is not a built-in method ({', '.join(BUILT_IN)}); a command line must contain "
            '{dataset} and {output}, such as --method "python my_method.py {dataset} {output}"'
        )
    try:
        shlex.split(method)
    except ValueError as error:
        raise UserError(f"--method {printable(method)[:80]!r} is not a command line ({error}); check its quotation marks") from None
    return method


@dataclass(frozen=True, kw_only=True)
class Conditions:
    """Conditions under which a method runs."""

    cameras: CameraSource = "estimated"
    """Cameras in the method's input, see `offer`."""
    timeout_s: float = TIMEOUT_S
    """Timeout for one case, after which the method and its child processes are killed."""
    keep: Path | None = None
    """Folder in which the output of the method is stored, with one subfolder per case. It is None if the output is
    deleted."""


def run(
    benchmark: Benchmark,
    folder: Path,
    method: str,
    *,
    conditions: Conditions = Conditions(),
    finished: Mapping[str, Row] | None = None,
    say: Callable[[Row], None] = lambda _: None,
) -> list[Row]:
    """Run a method on each case of a benchmark in a folder without ground truth, and score the output.

    A failure of the method is recorded in the row of the case.

    Parameters
    ----------
    benchmark : Benchmark
        Benchmark to run.
    folder : path
        Folder of the rendered datasets.
    method : str
        Built-in method, or command line in which ``{dataset}`` and ``{output}`` are replaced by paths.
    conditions : Conditions
        Conditions under which the method runs.
    finished : mapping from str to Row, optional
        Rows of an interrupted run by case, which are reused; None if no run was interrupted.
    say : callable
        Function that is called with each row.

    Returns
    -------
    list of Row
        One row per case.

    Raises
    ------
    UserError
        If an output subfolder already exists in ``keep``, although no run was interrupted.
    """
    command = command_of(method, cameras=conditions.cameras)
    keep = conditions.keep
    rows = []
    for case in benchmark.cases:
        if keep is not None and finished is None and (keep / case.name).exists():
            raise UserError(f"the folder {keep / case.name} already exists; remove the folder, or choose another folder for --keep")
    for case in benchmark.cases:
        row = (finished or {}).get(case.name) or _run_case(case.name, folder / case.name, command, conditions)
        rows.append(row)
        say(row)
    return rows


def score(benchmark: Benchmark, folder: Path, outputs: Path, *, say: Callable[[Row], None] = lambda _: None) -> list[Row]:
    """Score output folders that another program has written.

    The rows contain no running times and no memory, because these are unknown.

    Parameters
    ----------
    benchmark : Benchmark
        Benchmark on which the output was computed.
    folder : path
        Folder of the rendered datasets.
    outputs : path
        Folder of the outputs, with one subfolder per case.
    say : callable
        Function that is called with each row.

    Returns
    -------
    list of Row
        One row per case.
    """
    rows = []
    for case in benchmark.cases:
        there = (outputs / case.name).is_dir()
        row = Row(case=case.name, state="done" if there else "nothing", sentence="" if there else f"{outputs / case.name} does not exist")
        rows.append(_scored(row, outputs / case.name, folder / case.name))
        say(rows[-1])
    return rows


def as_json(benchmark: Benchmark, method: str, rows: list[Row], *, name: str, cameras: CameraSource | None) -> dict[str, Any]:
    """Convert rows to the JSON values of a results file.

    The file also contains the versions of software, a description of the computer, and the options of the run.

    Parameters
    ----------
    benchmark : Benchmark
        Benchmark of the rows.
    method, name : str
        Command line of the method, and its name in tables.
    rows : list of Row
        Rows from `run` or `score`.
    cameras : str or None
        Cameras in the method's input; None if unknown.
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


def finished_rows(path: Path, benchmark: Benchmark, method: str, *, cameras: CameraSource) -> dict[str, Row] | None:
    """Return the rows of cases that an interrupted run with the same command has already finished.

    Parameters
    ----------
    path : path
        Results file of the interrupted run.
    benchmark : Benchmark
        Benchmark to run.
    method, cameras : str
        Arguments of the run, see `run`.

    Returns
    -------
    dict of Row or None
        Rows by case, or None if there is no such file or its run is complete. A complete run is repeated, because the
        method may have changed.
    """
    try:
        stored = json.loads(read_file(path).decode("utf-8"))
        expected = (SCHEMA, benchmark.name, printable(method), cameras, version("rhizotwin"))
        if expected != (*(stored[name] for name in ("schema_version", "benchmark", "command", "cameras")), stored["versions"]["rhizotwin"]):
            return None
        rows = [Row(**row) for row in stored["rows"]]
    except (UserError, KeyError, TypeError, ValueError, RecursionError):
        return None
    is_complete = {row.case for row in rows} >= {case.name for case in benchmark.cases}
    return None if is_complete else {row.case: row for row in rows if row.state == "done"}


def _run_case(case: str, dataset: Path, command: str, conditions: Conditions) -> Row:
    """Run a method on one case, and score its output.

    If it is kept, the output is moved to this folder afterwards, where it replaces that of an interrupted run.
    """
    with _supervised() as (working, supervising):
        offered, output = working / "dataset", working / "output"
        try:
            offer(dataset, offered, cameras=conditions.cameras)
        except UserError as error:
            return Row(case=case, state="failed", sentence=f"the method was not run, because its input could not be written: {error}")
        words = [word.replace("{dataset}", str(offered)).replace("{output}", str(output)) for word in shlex.split(command)]
        row = _scored(_run_once(case, words, working, supervising, conditions.timeout_s), output, dataset)
        keep = conditions.keep
        if keep is not None and output.is_dir():
            keep.mkdir(parents=True, exist_ok=True)
            shutil.rmtree(keep / case, ignore_errors=True)
            shutil.move(output, keep / case)
        return row


@contextmanager
def _supervised() -> Iterator[tuple[Path, subprocess.Popen[str]]]:
    """Yield a temporary folder, and the process that removes it and ends the method, even if this process is killed."""
    with ExitStack() as stack:
        folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="rhizotwin-bench-", ignore_cleanup_errors=True))
        words = [sys.executable, "-I", supervisor.__file__, folder]
        started = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, start_new_session=True)
        yield Path(folder), stack.enter_context(started)  # at the end, its pipes are closed, and it cleans up


def _run_once(case: str, words: list[str], working: Path, supervising: subprocess.Popen[str], timeout_s: float) -> Row:
    """Run a command under supervision, and return its time and memory."""
    began = time.perf_counter()
    assert supervising.stdin is not None
    assert supervising.stdout is not None
    supervising.stdin.write(json.dumps({"words": words, "timeout_s": timeout_s}) + "\n")
    supervising.stdin.flush()
    measured = json.loads(supervising.stdout.readline() or '{"exit_code": -9}')  # someone has killed it
    wall_s = time.perf_counter() - began
    if "timeout" in measured:
        return Row(case=case, state="timeout", sentence=f"stopped at the time limit of {timeout_s:g} s", wall_s=wall_s)
    last = (working / "output.txt").read_bytes().decode(errors="replace").strip().splitlines()
    code = measured["exit_code"]
    cause = f": {printable(last[-1])[:_LAST_WORDS]}" if last else ""
    return Row(
        case=case,
        state="failed" if code else "done",
        sentence=f"exited with code {code}{cause}" if code else "",
        exit_code=code,
        wall_s=wall_s,
        cpu_s=measured.get("cpu_s"),
        memory_mib=measured.get("memory_mib"),
    )


def _scored(row: Row, output: Path, dataset: Path) -> Row:
    """Score the output of a case, and return a copy of the row that contains the scores."""
    if row.state != "done":
        return row
    scores, sentences = score_outputs(output, dataset)
    sentences = [sentence.replace(f"{output}{os.sep}", "") for sentence in sentences]
    state: State = "done" if scores else "unreadable" if sentences else "nothing"
    sentence = "; ".join(sentences) or ("" if scores else "the method wrote no output file with a known name (see docs/benchmark.md)")
    return replace(row, state=state, sentence=sentence, scores=scores)
