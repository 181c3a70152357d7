"""Rendering of the datasets of a benchmark, and comparison with reference fingerprints."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

from rhizotwin.bench import fingerprints
from rhizotwin.bench.benchmarks import Benchmark
from rhizotwin.bench.fingerprints import Comparison
from rhizotwin.scenes.dataset import load_dataset
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.monitor import Monitor
from rhizotwin.scenes.plan import count_pictures


def make(benchmark: Benchmark, folder: Path, *, monitor: Monitor, say: Callable[[str], None]) -> list[Comparison]:
    """Render a dataset for each case of a benchmark, or continue an interrupted rendering.

    Parameters
    ----------
    benchmark : Benchmark
        Benchmark to render.
    folder : path
        Folder for the datasets.
    monitor : Monitor
        Receiver of the progress.
    say : callable
        Function that is called with one line of output per case.

    Returns
    -------
    list of Comparison
        Comparison of each case with its reference fingerprint.
    """
    from rhizotwin.sim.simulate import simulate

    reference = fingerprints.reference(benchmark)
    found = []
    for case in benchmark.cases:
        simulate(case.rendered_scene(), folder / case.name, profile_name=case.profile, seed=case.seed, monitor=monitor)
        found.append(fingerprints.compare(folder / case.name, case.name, reference))
        say(sentence(found[-1]))
    return found


def sentence(one: Comparison) -> str:
    """Return a sentence for the user about the result of a comparison."""
    if not one.has_reference:
        return f"{one.case}: rendered; this version of the program has no reference for this case"
    if math.isinf(one.largest):
        return f"{one.case}: the number of pictures is DIFFERENT FROM THE REFERENCE"
    amount = f"maximum difference of sampled pixels {one.largest:.1e} of full scale (limit {fingerprints.LIMIT:g})"
    return f"{one.case}: {amount}, {'identical to the reference' if one.same else 'DIFFERENT FROM THE REFERENCE'}"


def check_made(benchmark: Benchmark, folder: Path) -> None:
    """Raise UserError if a case of a benchmark has not been rendered to a folder.

    Raises
    ------
    UserError
        If a case is missing, with the command that renders it, or the folder contains the case of another benchmark.
    """
    for case in benchmark.cases:
        command = f"rhizotwin bench make {benchmark.name} -o"
        if not (folder / case.name / "truth" / "truth.json").is_file():
            raise UserError(f"the case {case.name} is missing in {folder}; render it with: {command} {folder}")
        found = load_dataset(folder / case.name)
        pictures = count_pictures(case.rendered_scene())
        if (found.scene.camera.image_wh, len(found.frames), found.seed) != (case.image_wh, pictures, case.seed):
            raise UserError(
                f"{folder / case.name} was rendered for another benchmark than {benchmark.name}; render it with: {command} NEW_FOLDER"
            )
