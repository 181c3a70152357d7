"""Runs of small experiments on the emulated rig, in virtual time."""

import errno
import os
import shutil
import signal
import sqlite3
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from rhizotwin.catalogue.store import Catalogue
from rhizotwin.catalogue.verify import check
from rhizotwin.catalogue.visits import list_visits
from rhizotwin.rig.errors import UnsafeError
from rhizotwin.scenes.dataset import load_dataset
from rhizotwin.scenes.errors import UserError
from rhizotwin.timelapse.changers import CarouselChanger, PersonChanger
from rhizotwin.timelapse.experiment import Experiment, load_experiment
from rhizotwin.timelapse.runner import Listener, Runner
from tests.rhizotwin.timelapse.conftest import write_experiment

ROOT = Path(__file__).resolve().parents[3]
SCANS = 12
"""Scans of the run that is killed."""


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[str]]:
    """Return the file of an experiment with a carousel, which was stopped after its first scan and continued, and the output."""
    path = write_experiment(tmp_path_factory.mktemp("finished"), schedule='change = "carousel"')
    done, lines = list[str](), list[str]()
    stopping = Listener(on_visit=lambda visit: done.append(visit.state), stop=lambda: "scanned" in done)
    assert len(Runner(load_experiment(path), listener=stopping).run().open) == 3
    outcome = Runner(load_experiment(path), listener=Listener(say=lines.append)).run()
    assert (outcome.scanned, outcome.missed, outcome.open, outcome.growth) == (4, (), (), None)
    return path, lines


def test_every_plant_is_scanned_in_every_round(finished: tuple[Path, list[str]]):
    experiment, lines = load_experiment(finished[0]), finished[1]
    assert any("reconstruction of 2 scans was skipped, because sketches" in line for line in lines)
    with Catalogue.open(experiment.catalogue_path) as catalogue:
        assert check(catalogue) == []
        scans = catalogue.scans()
    planned = [("P1", 0.0), ("P2", 0.0), ("P1", 1.0), ("P2", 1.0)]
    assert [(one.plants, one.day, one.complete) for one in scans] == [((plant,), day, True) for plant, day in planned]
    assert [load_dataset(one.path).scene.subject.plant for one in scans] == [plant for plant, _ in planned]
    assert Runner(experiment).run().scanned == 4  # nothing is left to do


def test_lost_catalogue_is_filled_from_the_datasets(finished: tuple[Path, list[str]], tmp_path: Path):
    """A dataset of another plant is not recorded."""
    experiment = load_experiment(Path(shutil.copytree(finished[0].parent, tmp_path / "copy")) / finished[0].name)
    taken = {path: path.stat().st_mtime_ns for path in experiment.scans_folder.rglob("*.png")}
    experiment.catalogue_path.unlink()
    assert Runner(experiment).run().scanned == 4
    assert {path: path.stat().st_mtime_ns for path in experiment.scans_folder.rglob("*.png")} == taken
    experiment.catalogue_path.unlink()
    (experiment.scans_folder / "P1_day_000.00").rename(experiment.scans_folder / "x")
    (experiment.scans_folder / "P2_day_000.00").rename(experiment.scans_folder / "P1_day_000.00")
    outcome = Runner(experiment).run()
    assert "contains a scan of plant 'P2' instead of P1" in outcome.missed[0].note
    assert outcome.scanned == 3


def test_wrong_canister_is_not_scanned(make_experiment):
    experiment, questions = load_experiment(make_experiment(rounds=1)), list[str]()
    canisters = [9, 0, 9, 1, 2]  # of no plant, none and of no plant; of the other plant, then right

    def ask(question: str) -> str:
        runner.table.put(canisters[len(questions)])
        questions.append(question)
        return ""

    runner = Runner(experiment, listener=Listener(ask=ask), changer=PersonChanger(ask))
    outcome = runner.run()
    first, unknown, none, second, other = questions
    assert first == "Put canister 1 (plant P1) on the turntable, then press Enter: "
    assert "(APRILTAG_36h11 markers 1" in unknown
    assert "could not be read" in none
    assert second == "Put canister 2 (plant P2) on the turntable, then press Enter: "
    assert "is P1 instead of P2" in other
    assert ([one.plant for one in outcome.missed], outcome.scanned) == (["P1"], 1)
    assert "matches no plant" in outcome.missed[0].note
    assert {path.parts[-3] for path in experiment.scans_folder.rglob("*.png")} == {"P2_day_000.00"}  # nothing is left of P1
    assert load_dataset(experiment.scans_folder / "P2_day_000.00").scene.strip.first_id == 22


@pytest.mark.parametrize(("pause_min", "loads"), [(1, 2), (800, 1)], ids=["tried again", "too late"])
def test_blocked_carousel(make_experiment, pause_min: int, loads: int):
    """It is blocked at its first movement."""
    experiment = load_experiment(make_experiment(plants=1, rounds=1, schedule=f"pause_min = {pause_min}"))
    places, lines = list[int](), list[str]()

    def load(place: int) -> None:
        places.append(place)
        if len(places) == 1:
            raise UnsafeError("carousel: the carousel does not rotate; remove the obstacle and continue")
        runner.table.put(place)

    carousel = SimpleNamespace(describe=lambda: "blocked", load=load, **dict.fromkeys(("prepare", "unload", "close"), lambda: None))
    runner = Runner(experiment, listener=Listener(say=lines.append), changer=CarouselChanger(carousel))
    outcome = runner.run()
    assert (outcome.scanned, len(places)) == (loads - 1, loads)
    assert any("attempt 1 of 3 failed: carousel: the carousel does not rotate" in line for line in lines)
    assert ["the carousel does not rotate" in one.note for one in outcome.missed] == [True] * (2 - loads)


def test_stray_file_of_one_plant_does_not_end_the_run(make_experiment):
    experiment = load_experiment(make_experiment(plants=2, rounds=1))
    note = experiment.scans_folder / "P1_day_000.00" / "note.txt"
    note.parent.mkdir(parents=True)
    note.write_text("a leaf broke")
    outcome = Runner(experiment).run()
    assert ([one.plant for one in outcome.missed], outcome.scanned) == (["P1"], 1)
    assert "is not empty and contains no interrupted scan" in outcome.missed[0].note


def fail(cause: Exception) -> Callable[..., None]:
    """Return a function that raises UserError because of another error."""

    def take(*_: object, **__: object) -> None:
        raise UserError("free some space") from cause

    return take


FAULTS = {
    "disk full": ("rhizotwin.rigs.take_scan", fail(OSError(errno.ENOSPC, "full"))),
    "catalogue locked": ("rhizotwin.rigs.take_scan", fail(sqlite3.OperationalError("database is locked"))),
    "too little space for the pictures": ("shutil.disk_usage", lambda _: SimpleNamespace(total=2**40, free=2**24)),
}


def test_faults_that_end_the_run_and_not_the_scan(make_experiment, monkeypatch: pytest.MonkeyPatch):
    experiment = load_experiment(make_experiment(plants=1, rounds=1))
    with pytest.raises(UserError, match="needs a person who puts its canister"):
        Runner(experiment, changer=PersonChanger(None)).run()
    for name, function in FAULTS.values():
        with monkeypatch.context() as patch:
            patch.setattr(name, function)
            with pytest.raises(UserError, match="free some space"):
                Runner(experiment).run()
    assert Runner(experiment).run().scanned == 1


def files(experiment: Experiment) -> set[Path]:
    """Return the catalogue, if there is one, and the pictures."""
    return {*experiment.folder.glob("*.rhizotwin"), *experiment.scans_folder.glob("*/images/*.png")}


@pytest.mark.slow
def test_killed_at_several_points(make_experiment):
    """Nothing is lost, nothing is scanned twice, and the catalogue agrees with the files."""
    path = make_experiment(plants=SCANS // 3, rounds=3)
    words = [sys.executable, "-m", "rhizotwin", "timelapse", "run", str(path)]
    experiment, kept = load_experiment(path), dict[Path, int]()
    for delay_s in np.linspace(0.0, 1.5, 6):  # after the first change of each run
        before = files(experiment)
        with subprocess.Popen(words, cwd=ROOT, stdout=subprocess.DEVNULL, start_new_session=True) as running:
            while running.poll() is None and files(experiment) == before:
                time.sleep(0.01)
            time.sleep(delay_s)
            os.killpg(running.pid, signal.SIGKILL)
        assert running.returncode == -signal.SIGKILL
        if experiment.catalogue_path.stat().st_size:
            with Catalogue.open_or_create(experiment.catalogue_path) as catalogue:
                assert {one.kind for one in check(catalogue)} <= {"unlisted"}  # finished or begun, and not recorded yet
                pictures = [file for scan in catalogue.scans() for file in scan.path.rglob("*.png")]
            kept = {file: file.stat().st_mtime_ns for file in pictures} | kept
    assert kept
    subprocess.run(words, cwd=ROOT, stdout=subprocess.DEVNULL, check=True, timeout=600)
    with Catalogue.open(experiment.catalogue_path) as catalogue:
        visits = list_visits(catalogue)
        assert [one.state for one in visits] == ["scanned"] * SCANS
        assert len({one.scan for one in visits}) == len(catalogue.scans()) == SCANS
        assert check(catalogue) == []
    assert len(list(experiment.scans_folder.iterdir())) == SCANS
    assert {file: file.stat().st_mtime_ns for file in kept} == kept  # no picture was taken again
