"""Render a named benchmark."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from rhizotwin.bench import fingerprints
from rhizotwin.bench.benchmarks import Benchmark
from rhizotwin.bench.fingerprints import Comparison
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.monitor import Monitor


def make(benchmark: Benchmark, folder: Path, *, monitor: Monitor, say: Callable[[str], None]) -> list[Comparison]:
    """Render the cases of a benchmark, a dataset each; a stopped run is taken up.

    Parameters
    ----------
    benchmark : Benchmark
        Its cases.
    folder : path
        Where the datasets go.
    monitor : Monitor
        Hears of every view.
    say : callable
        Hears a line a case.

    Returns
    -------
    list of Comparison
        Each case against the package's fingerprint.
    """
    from rhizotwin.sim.simulate import simulate

    reference, found = fingerprints.reference(benchmark), []
    for case in benchmark.cases:
        simulate(case.rendered_scene(), folder / case.name, profile_name=case.profile, seed=case.seed, monitor=monitor)
        found.append(fingerprints.compare(folder / case.name, case.name, reference))
        say(sentence(found[-1]))
    return found


def sentence(one: Comparison) -> str:
    """Return a comparison in words."""
    if one.largest == float("inf"):
        return f"{one.case}: rendered; this version has no fingerprint of it"
    amount = f"sampled pixels differ by {one.largest:.1e} of full scale at most (limit {fingerprints.LIMIT:g})"
    return f"{one.case}: {amount}, {'the same data' if one.same else 'NOT THE SAME DATA as the reference'}"


def check_made(benchmark: Benchmark, folder: Path) -> None:
    """Refuse a folder that lacks a case; UserError names the command that makes it."""
    for case in benchmark.cases:
        if not (folder / case.name / "truth" / "truth.json").is_file():
            raise UserError(f"{folder} lacks {case.name}; make it with: rhizotwin bench make {benchmark.name} -o {folder}")
