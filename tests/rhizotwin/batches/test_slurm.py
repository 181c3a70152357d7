"""Jobs in Slurm's queue: what is requested again, what fails, and what is said, with a queue of a few lines."""

from pathlib import Path

import pytest

from rhizotwin.batches import jobs, slurm
from rhizotwin.batches.jobs import Outcome
from rhizotwin.scenes.errors import UserError
from tests.rhizotwin.batches.conftest import job

OOM = "slurmstepd: error: Detected 1 oom-kill event(s) in StepId=7.batch."
ENDS = {
    "done": "COMPLETED||None|1:00:00",
    "memory": "OUT_OF_MEMORY||OutOfMemory|1:00:00",
    "log": "FAILED||JobLaunchFailure|1:00:00",
    "time": "TIMEOUT||TimeLimit|1-00:30:00",
    "scancel": "CANCELLED||None|1:00:00",
    "node": "NODE_FAIL||NodeDown|1:00:00",
    "python": "FAILED||NonZeroExitCode|1:00:00",
}
"""What squeue says of a job that has ended."""
CASES: dict[str, tuple[str, list[str], str]] = {
    "memory done": ("", ["2250M", "4500M"], "it needed more than the requested 2250 MiB of memory; it is submitted again with 4500 MiB"),
    "log done": ("", ["2250M", "4500M"], "it needed more than the requested 2250 MiB of memory"),
    "memory memory": ("more than the requested 4500 MiB of memory; use larger voxels", ["2250M", "4500M"], "4500 MiB"),
    "time done": ("", ["2250M", "2250M 2940"], "it reached its time limit of 1-00:30:00; it is submitted again with 2940 min"),
    "scancel node done": ("", ["2250M"] * 3, "it was ended by Slurm (NODE_FAIL); it is submitted again"),
    "scancel scancel scancel": ("ended by Slurm (CANCELLED); run the same command again", ["2250M"] * 3, "(CANCELLED)"),
    "python": ("without a record (sh: python: not found); check that the nodes", ["2250M"], "submitted as Slurm job 1 with 2250 MiB"),
    "refused": ("configuration is not available (requested: 2250 MiB)", ["2250M"], ""),
    "earlier": ("", [], "Slurm job 7 of an earlier run is continued"),
    "Ctrl-C": ("", ["2250M"], "scancel 1"),
}
"""Ends of the submissions; then the failure, memory and time of each request, and a part of what is said."""


@pytest.mark.parametrize("ends", CASES)
def test_each_end_of_a_job(ends: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sentence, requests, line = CASES[ends]
    script, one, said = ends.split(), job("a", tmp_path), list[str]()
    requested, rows = list[str](), list[str]()

    def end(number: str, state: str) -> None:
        slurm._log_file(one, number).parent.mkdir(exist_ok=True)
        slurm._log_file(one, number).write_text(OOM if state == "log" else "sh: python: not found\n", encoding="utf-8")
        rows.append(f"{number}|{ENDS[state]}")
        if state == "done":
            monkeypatch.setenv("SLURM_JOB_ID", number)
            jobs.note(one, Outcome(name=one.name, state="done"))

    def call(program: str, *words: str, **_: str | None) -> str:
        if program == "squeue" and "all" not in words:
            return f"7|{slurm._name(one)}\n" if rows else ""
        if program == "squeue" and ends == "Ctrl-C":
            raise KeyboardInterrupt
        if program != "sbatch":
            said.append(" ".join([program, *words]))
            return "\n".join(rows)
        requested.append(" ".join(word.partition("=")[2] for word in words if word.startswith(("--mem", "--time"))))
        if ends == "refused":
            raise UserError("sbatch failed: Requested node configuration is not available")
        if ends != "Ctrl-C":
            end(str(len(requested)), script[len(requested) - 1])
        return f"{len(requested)}\n"

    if ends == "earlier":
        end("7", "done")
    for name, value in {"_call": call, "POLL_S": 0.0, "RECORD_S": 0.0}.items():
        monkeypatch.setattr(slurm, name, value)
    monkeypatch.setattr("shutil.which", lambda _: "/usr/bin/sbatch")
    try:
        ((_, outcome),) = slurm.run([one], workers=None, say=said.append)
    except KeyboardInterrupt:
        outcome = Outcome(name="a", state="done")
    assert outcome.state == ("failed" if sentence else "done")
    assert sentence in outcome.sentence
    assert requested == requests
    assert any(line in one for one in said) or not line
