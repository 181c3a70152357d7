"""Execution of one job in the current process.

Errors are converted to messages in the outcome of the job.
"""

from __future__ import annotations

import errno
import json
import logging
import tempfile
import time
from pathlib import Path
from typing import Any

from rhizotwin import engine
from rhizotwin.batches import places
from rhizotwin.batches.jobs import HEADS, Job, Outcome, State, note
from rhizotwin.scenes import formatting, memory
from rhizotwin.scenes.errors import UserError
from rhizotwin.steps.arguments import Progress

OF_DISK = (*formatting.FULL, errno.EIO, errno.ESTALE)
"""Values of errno that indicate a failure of the disk or network. A job that fails with one of them is repeated."""


def work(plain: dict[str, Any], threads: int | None = None) -> dict[str, Any]:
    """Run a job, and write its record.

    Parameters
    ----------
    plain : dict of object
        Job as JSON values, see `Job.plain`.
    threads : int or None
        Number of threads; None: number of processors.

    Returns
    -------
    dict of object
        Fields of the `Outcome`, as JSON values.
    """
    job = Job(**plain)
    begin = time.perf_counter()
    state: State
    try:
        engine.ensure(job.options.get("device", "auto"))
        if threads is not None:
            engine.most_threads(threads)
        (_reconstruct if job.kind == "reconstruct" else _simulate)(job)
        state, sentence = "done", ""
    except UserError as error:
        disk = isinstance(error.__cause__, OSError) and error.__cause__.errno in OF_DISK
        state = "again" if disk else "failed"
        sentence = str(error)
    except MemoryError as error:
        state = "again"
        sentence = formatting.error_sentence(error)
    except OSError as error:
        state = "again" if error.errno in OF_DISK else "failed"
        sentence = formatting.error_sentence(error)
    except Exception as error:  # a fault of one scan must not end the batch
        logging.getLogger(__name__).debug("job %s", job.name, exc_info=True)
        state = "failed"
        sentence = formatting.error_sentence(error)
    outcome = Outcome(name=job.name, state=state, sentence=sentence, seconds=time.perf_counter() - begin, peak_mib=memory.peak_mib())
    try:
        note(job, outcome)
    except (OSError, UserError) as error:
        outcome = Outcome(name=job.name, state="again", sentence=formatting.error_sentence(error), seconds=outcome.seconds)
    return vars(outcome)


def _reconstruct(job: Job) -> None:
    from rhizotwin.recon.settings import PictureSettings
    from rhizotwin.steps.command_steps import Wanted, reconstruct_whole, settings_of
    from rhizotwin.stored.result_files import RESULT_NAMES

    settings = job.options.get("settings")
    with tempfile.TemporaryDirectory(prefix="rhizotwin-batch-") as scratch:
        dataset, output = Path(job.source), Path(job.output)
        if places.is_address(job.source):
            dataset = Path(scratch, "dataset", job.name)
            places.fetch(job.source, dataset)
        if places.is_address(job.output):
            output = Path(scratch, "result", job.name)
        file = Path(scratch, "settings.toml")
        if settings is not None:
            file.write_text(settings, encoding="utf-8")
        chosen = None if settings is None else file
        tolerant = PictureSettings(tolerant=True)
        given = settings_of(chosen, voxel_mm=job.options.get("voxel_mm"), pictures=tolerant)
        reconstruct_whole(dataset, output, Wanted(settings=given), progress=Progress(quiet=True))
        if places.is_address(job.output):
            places.put(output, job.output, last=HEADS["reconstruct"], replaces=RESULT_NAMES)


def _simulate(job: Job) -> None:
    from rhizotwin.scenes import files
    from rhizotwin.sim.simulate import simulate

    scene = files.scene_from_dict(json.loads(job.source), where=job.name)
    options = job.options
    with tempfile.TemporaryDirectory(prefix="rhizotwin-batch-") as scratch:
        output = Path(scratch, job.name) if places.is_address(job.output) else Path(job.output)
        simulate(scene, output, profile_name=options["profile"], seed=options["seed"])
        if places.is_address(job.output):
            places.put(output, job.output, last=HEADS["simulate"])
