"""Scan the same plants repeatedly according to a schedule.

An experiment file describes plants, schedule, rig and folders.

Examples
--------
rhizotwin timelapse example -o my_experiment.toml
rhizotwin timelapse run my_experiment.toml
rhizotwin timelapse status my_experiment.toml
rhizotwin timelapse tips results scans -o my_tips
"""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from rhizotwin.scenes.formatting import count
from rhizotwin.steps.arguments import Flag, OutputFile, OutputFolder, Progress, check_new_file, with_metavar

if TYPE_CHECKING:
    from rhizotwin.timelapse.experiment import Experiment
    from rhizotwin.timelapse.runner import Outcome

ExperimentFile = Annotated[Path, with_metavar("EXPERIMENT")]


def example(*, output: OutputFile) -> None:
    """Write a complete, commented experiment file as a starting point.

    The experiment of the example has six plants in two treatments, which are scanned once a day for ten days on the
    emulated rig. It can be run without changes.

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

    check_new_file(output, ".toml")
    atomic.write_text(output, EXAMPLE, new=True)
    print(f"wrote {output}")
    print(f"next: rhizotwin timelapse run {output}")


def run(experiment: ExperimentFile, /, *, progress: Progress = Progress()) -> None:
    """Run a time-lapse experiment until its schedule is complete.

    At each planned time, a person is asked to put the canister of the plant on the turntable, or a carousel does so.
    The plant is identified by the numbers of its markers in the first picture, and a wrong plant is not scanned.
    Finished scans are reconstructed while no other scan is due, and the growth curves are updated. Each step is stored
    in a catalogue, so that after any interruption, even a power failure, the same command continues the experiment. On
    the emulated rig, the program does not wait for the planned times.

    Parameters
    ----------
    experiment : Path
        Experiment file (TOML; 'rhizotwin timelapse example' writes an example).
    progress : Progress
        Progress output.

    Examples
    --------
    rhizotwin timelapse run my_experiment.toml
    """
    from rhizotwin.steps import rigs
    from rhizotwin.timelapse.experiment import load_experiment
    from rhizotwin.timelapse.runner import Listener, Runner

    loaded = load_experiment(experiment)
    say = _silent if progress.quiet else print
    listener = Listener(say=say, say_devices=say if progress.verbose else _silent, ask=rigs.asker())
    outcome = Runner(loaded, listener=listener).run()
    _print(loaded, outcome)


def status(experiment: ExperimentFile, /, *, every: Flag = False) -> None:
    """Print the numbers of finished, missed and planned scans of an experiment.

    Parameters
    ----------
    experiment : Path
        Experiment file (TOML).
    every : bool
        List all scans with their states.

    Examples
    --------
    rhizotwin timelapse status my_experiment.toml
    """
    from rhizotwin.catalogue.store import Catalogue
    from rhizotwin.catalogue.visits import list_visits
    from rhizotwin.timelapse.experiment import load_experiment
    from rhizotwin.timelapse.runner import outcome_of

    loaded = load_experiment(experiment)
    if not loaded.catalogue_path.exists():
        print(f"{count(len(loaded.visits()), 'scan')} planned; none has been started")
        return
    with Catalogue.open(loaded.catalogue_path, read_only=True) as catalogue:
        for visit in list_visits(catalogue) if every else ():
            print(f"{visit.due_utc}  {visit.state:<9}{visit.plant}{f': {visit.note}' if visit.note else ''}")
        _print(loaded, outcome_of(loaded, catalogue))


def tips(sources: Annotated[list[Path], with_metavar("SOURCES")], /, *, output: OutputFolder, progress: Progress = Progress()) -> None:
    """Measure the motion of root tips in short scans.

    The roots are those of the full scans. In each later scan, their tips are fitted to the pictures. The tables contain
    speed, elongation, curvature and angle to gravity of each tip, and circumnutation, with 90 % intervals.

    Parameters
    ----------
    sources : list of Path
        Results of full scans and datasets of short scans, folders that contain them, or a catalogue (.rhizotwin).
    output : Path
        Output folder for tips.csv (each root and scan), tracks.csv (mean rates and circumnutation of each root) and
        tips.png.
    progress : Progress
        Progress output.

    Examples
    --------
    rhizotwin timelapse tips results scans -o my_tips
    rhizotwin timelapse tips my_experiment.rhizotwin -o my_tips
    """
    from rhizotwin import engine
    from rhizotwin.catalogue import sources as listed

    engine.start("auto")
    from rhizotwin.experiment import motion_files

    scans = [Path(path) for path in listed.expand_scans([str(source) for source in sources if listed.is_catalogue(source)])]
    results, found = motion_files.find_sources([*listed.expand_results(sources), *scans])
    for sentence in motion_files.write(results, found, output, say=print if progress.verbose else _silent):
        print(sentence)
    print(f"tables: {output / 'tips.csv'}, {output / 'tracks.csv'}; figure: {output / 'tips.png'}")


def _silent(_: str) -> None:
    """Discard a line of output."""


def _print(experiment: "Experiment", outcome: "Outcome") -> None:
    """Print how many scans are finished, missed and still planned.

    Each missed scan is printed with its reason, followed by the paths of the growth report and the catalogue.
    """
    print(f"scans: {outcome.scanned} finished, {len(outcome.missed)} missed, {len(outcome.open)} still planned")
    for visit in outcome.missed:
        print(f"missed: {visit.plant}, planned for {visit.due_utc}: {visit.note}")
    if outcome.growth is not None:
        print(f"report: {outcome.growth}")
    print(f"catalogue: {experiment.catalogue_path}")
