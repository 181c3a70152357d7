"""Scan the same plants again and again by a schedule.

Examples
--------
rhizotwin timelapse example -o my_experiment.toml
rhizotwin timelapse run my_experiment.toml
rhizotwin timelapse status my_experiment.toml
"""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from rhizotwin.arguments import Flag, OutputFile, Progress, with_metavar
from rhizotwin.scenes.errors import UserError

if TYPE_CHECKING:
    from rhizotwin.timelapse.experiment import Experiment
    from rhizotwin.timelapse.runner import Outcome

ExperimentFile = Annotated[Path, with_metavar("EXPERIMENT")]


def example(*, output: OutputFile) -> None:
    """Write a complete, commented experiment file as a starting point.

    It has six plants in two treatments, scanned once a day for ten days on the emulated rig, and runs as it is.

    Parameters
    ----------
    output : Path
        File to write (.toml); must not exist yet.

    Examples
    --------
    rhizotwin timelapse example -o my_experiment.toml
    """
    from rhizotwin.scenes import atomic
    from rhizotwin.timelapse.example import EXAMPLE

    if output.suffix != ".toml" or output.exists():
        raise UserError(f"{output} {'already exists; choose another name' if output.exists() else 'must end in .toml'}")
    atomic.write_text(output, EXAMPLE, new=True)
    print(f"wrote {output}")
    print(f"next: rhizotwin timelapse run {output}")


def run(experiment: ExperimentFile, /, *, progress: Progress = Progress()) -> None:
    """Run a time-lapse experiment until its schedule is done.

    At each due time a person is asked to put the canister of the plant on the table, or a carousel does it. The first
    picture shows by the numbers of the strip which plant it is; another plant is not scanned. Then the scan is made,
    reconstructed while no other scan is due, and the curves of growth are updated. The catalogue holds each step, so
    that after an interruption at any point, also a power cut, the same command continues. On the emulated rig the time
    of the schedule passes at once.

    Parameters
    ----------
    experiment : Path
        Experiment file (TOML; 'rhizotwin timelapse example' writes one).
    progress : Progress
        Amount of output during the scans.

    Examples
    --------
    rhizotwin timelapse run my_experiment.toml
    """
    from rhizotwin import rigs
    from rhizotwin.timelapse.experiment import load_experiment
    from rhizotwin.timelapse.runner import Listener, Runner

    loaded = load_experiment(experiment)
    say = _silent if progress.quiet else print
    listener = Listener(say=say, say_devices=say if progress.verbose else _silent, ask=rigs.asker())
    outcome = Runner(loaded, listener=listener).run()
    _print(loaded, outcome)


def status(experiment: ExperimentFile, /, *, every: Flag = False) -> None:
    """Print which scans of an experiment are made, missed and still to be made.

    Parameters
    ----------
    experiment : Path
        Experiment file.
    every : bool
        List every scan.

    Examples
    --------
    rhizotwin timelapse status my_experiment.toml
    """
    from rhizotwin.catalogue.store import Catalogue
    from rhizotwin.timelapse.experiment import load_experiment
    from rhizotwin.timelapse.runner import outcome_of

    loaded = load_experiment(experiment)
    if not loaded.catalogue_path.exists():
        print(f"{len(loaded.visits())} scans are planned; none has been made")
        return
    with Catalogue.open(loaded.catalogue_path, read_only=True) as catalogue:
        for visit in catalogue.visits() if every else ():
            print(f"{visit.due_utc}  {visit.state:<9}{visit.plant}{f': {visit.note}' if visit.note else ''}")
        _print(loaded, outcome_of(loaded, catalogue))


def _silent(_: str) -> None:
    """Print nothing."""


def _print(experiment: "Experiment", outcome: "Outcome") -> None:
    """Print the number of scans, each missed scan with its reason, and the paths of growth report and catalogue."""
    print(f"{outcome.scanned} scans made, {len(outcome.missed)} missed, {len(outcome.open)} still to be made")
    for visit in outcome.missed:
        print(f"missed: {visit.plant}, due {visit.due_utc}: {visit.note}")
    if outcome.growth is not None:
        print(f"report: {outcome.growth}")
    print(f"catalogue: {experiment.catalogue_path}")
