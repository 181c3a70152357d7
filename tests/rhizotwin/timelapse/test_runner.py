"""Runs of small experiments on the emulated rig, in virtual time."""

import errno
import os
import random
import signal
import sqlite3
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from rhizotwin.catalogue.store import Catalogue
from rhizotwin.catalogue.verify import check
from rhizotwin.catalogue.visits import list_visits
from rhizotwin.rig.errors import UnsafeError
from rhizotwin.scenes.dataset import load_dataset
from rhizotwin.scenes.errors import UserError
from rhizotwin.timelapse.changers import CarouselChanger, PersonChanger
from rhizotwin.timelapse.experiment import load_experiment
from rhizotwin.timelapse.runner import Listener, Runner
from rhizotwin.timelapse.table import EmulatedTable

ROOT = Path(__file__).resolve().parents[3]
KILLS = 20


def test_every_plant_is_scanned_in_every_round(make_experiment):
    experiment, lines = load_experiment(make_experiment(plants=2, rounds=2)), list[str]()
    outcome = Runner(experiment, listener=Listener(say=lines.append)).run()
    assert (outcome.scanned, outcome.missed, outcome.open, outcome.growth) == (4, (), (), None)
    assert any("reconstruction of 2 scans was skipped, because sketches" in line for line in lines)
    with Catalogue.open(experiment.catalogue_path) as catalogue:
        assert check(catalogue) == []
        assert [(one.plants, one.day, one.complete) for one in catalogue.scans()] == [
            (("P1",), 0.0, True),
            (("P2",), 0.0, True),
            (("P1",), 1.0, True),
            (("P2",), 1.0, True),
        ]
        for scan in catalogue.scans():
            subject = load_dataset(scan.path).scene.subject
            assert (subject.plant,) == scan.plants
    again = Runner(experiment).run()  # nothing is left to do
    assert again.scanned == 4


class Hand:
    """A person who puts canisters on the emulated table, at first the wrong ones."""

    def __init__(self, canisters: list[int]) -> None:
        self.canisters = canisters
        self.questions = list[str]()
        self.runner: Runner | None = None

    def ask(self, question: str) -> str:
        """Put the next canister on the table."""
        self.questions.append(question)
        assert self.runner is not None
        assert isinstance(self.runner.table, EmulatedTable)
        self.runner.table.put(self.canisters.pop(0))
        return ""


def test_wrong_canister_is_not_scanned(make_experiment):
    experiment = load_experiment(make_experiment(plants=2, rounds=1, schedule="tries = 4"))
    hand = Hand([2, 0, 9, 1, 2])  # of the other plant, none, of no plant, then right
    hand.runner = Runner(experiment, listener=Listener(ask=hand.ask), changer=PersonChanger(hand.ask))
    assert hand.runner.run().scanned == 2
    first, other, none, unknown, second = hand.questions
    assert first == "Put canister 1 (plant P1) on the turntable, then press Enter: "
    assert "is P2 instead of P1" in other
    assert "could not be read" in none
    assert "(APRILTAG_36h11 markers 1" in unknown
    assert second == "Put canister 2 (plant P2) on the turntable, then press Enter: "
    for scan, ids in (("P1_day_000.00", 0), ("P2_day_000.00", 22)):
        dataset = load_dataset(experiment.scans_folder / scan)
        assert dataset.scene.strip.first_id == ids


def test_wrong_canister_to_the_end_is_missed_and_leaves_nothing(make_experiment):
    experiment = load_experiment(make_experiment(plants=1, rounds=1))
    hand = Hand([5, 5, 5])
    hand.runner = Runner(experiment, listener=Listener(ask=hand.ask), changer=PersonChanger(hand.ask))
    (missed,) = hand.runner.run().missed
    assert "matches no plant" in missed.note
    assert not list(experiment.scans_folder.rglob("*.png"))


def test_nobody_there(make_experiment):
    experiment = load_experiment(make_experiment(plants=1, rounds=1))
    with pytest.raises(UserError, match="needs a person who puts its canister"):
        Runner(experiment, changer=PersonChanger(None)).run()
    assert Runner(experiment).run().scanned == 1


def test_attempt_that_comes_too_late_is_not_made(make_experiment):
    experiment = load_experiment(make_experiment(plants=1, rounds=1, schedule="pause_min = 800"))
    carousel = Blocked()
    carousel.runner = Runner(experiment, changer=CarouselChanger(carousel))
    (missed,) = carousel.runner.run().missed
    assert carousel.loads == 1
    assert "the carousel does not rotate" in missed.note


def test_carousel(make_experiment):
    experiment = load_experiment(make_experiment(plants=3, rounds=1, schedule='change = "carousel"'))
    assert Runner(experiment).run().scanned == 3


class Blocked:
    """A carousel that is blocked at its first movement."""

    def __init__(self) -> None:
        self.loads = 0
        self.runner: Runner | None = None

    def describe(self) -> str:
        """Return a short description."""
        return "blocked"

    def prepare(self) -> None:
        """Do nothing."""

    def load(self, place: int) -> None:
        """Fail once, then load."""
        self.loads += 1
        if self.loads == 1:
            raise UnsafeError("carousel: the carousel does not rotate; remove the obstacle and continue")
        assert self.runner is not None
        assert isinstance(self.runner.table, EmulatedTable)
        self.runner.table.put(place)

    def unload(self) -> None:
        """Do nothing."""

    def close(self) -> None:
        """Do nothing."""


def test_blocked_carousel_is_tried_again(make_experiment):
    experiment, carousel, lines = load_experiment(make_experiment(plants=1, rounds=1)), Blocked(), list[str]()
    carousel.runner = Runner(experiment, listener=Listener(say=lines.append), changer=CarouselChanger(carousel))
    assert carousel.runner.run().scanned == 1
    assert any("attempt 1 of 3 failed: carousel: the carousel does not rotate" in line for line in lines)


def test_listener_stops_the_run_between_scans(make_experiment):
    experiment, done = load_experiment(make_experiment(plants=2, rounds=1)), list[str]()
    listener = Listener(on_visit=lambda visit: done.append(visit.state), stop=lambda: "scanned" in done)
    assert len(Runner(experiment, listener=listener).run().open) == 1
    assert Runner(experiment).run().scanned == 2


def test_dataset_of_another_plant_is_not_recorded(make_experiment):
    experiment = load_experiment(make_experiment(plants=2, rounds=1))
    Runner(experiment, listener=Listener()).run()
    experiment.catalogue_path.unlink()
    (experiment.scans_folder / "P1_day_000.00").rename(experiment.scans_folder / "x")
    (experiment.scans_folder / "P2_day_000.00").rename(experiment.scans_folder / "P1_day_000.00")
    outcome = Runner(experiment).run()
    assert "contains a scan of plant 'P2' instead of P1" in outcome.missed[0].note
    assert outcome.scanned == 1


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


@pytest.mark.parametrize(
    ("name", "function"),
    [
        ("rhizotwin.rigs.take_scan", fail(OSError(errno.ENOSPC, "full"))),
        ("rhizotwin.rigs.take_scan", fail(sqlite3.OperationalError("database is locked"))),
        ("shutil.disk_usage", lambda _: SimpleNamespace(total=2**40, free=2**24)),
    ],
    ids=["disk full", "catalogue locked", "too little space for the pictures"],
)
def test_full_disk_or_locked_catalogue_ends_the_run(make_experiment, monkeypatch: pytest.MonkeyPatch, name: str, function: Any):
    experiment = load_experiment(make_experiment(plants=1, rounds=1))
    monkeypatch.setattr(name, function)
    with pytest.raises(UserError, match="free some space"):
        Runner(experiment).run()
    monkeypatch.undo()
    assert Runner(experiment).run().scanned == 1


def test_lost_catalogue_is_filled_from_the_datasets(make_experiment):
    experiment = load_experiment(make_experiment(plants=2, rounds=1))
    Runner(experiment).run()
    taken = {path: path.stat().st_mtime_ns for path in experiment.scans_folder.rglob("*.png")}
    experiment.catalogue_path.unlink()
    assert Runner(experiment).run().scanned == 2
    assert {path: path.stat().st_mtime_ns for path in experiment.scans_folder.rglob("*.png")} == taken


@pytest.mark.slow
def test_killed_at_random_points(make_experiment):
    """Kill the run 20 times: nothing is lost, nothing is scanned twice, and the catalogue agrees with the files."""
    path = make_experiment(plants=6, rounds=10, views=3)
    words = [sys.executable, "-m", "rhizotwin", "timelapse", "run", str(path)]
    rng, kills, kept = random.Random(43), 0, dict[Path, int]()
    experiment = load_experiment(path)
    while True:
        running = subprocess.Popen(words, cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, start_new_session=True)
        if kills < KILLS:
            time.sleep(rng.uniform(0.5, 5.0))
        else:
            _, errors = running.communicate(timeout=600)
            assert running.returncode == 0, errors.decode()[-500:]
            break
        if running.poll() is None:
            os.killpg(running.pid, signal.SIGKILL)
            kills += 1
        running.communicate()
        if experiment.catalogue_path.exists() and experiment.catalogue_path.stat().st_size:
            with Catalogue.open_or_create(experiment.catalogue_path) as catalogue:
                assert all(one.kind == "unlisted" for one in check(catalogue))  # finished or begun, and not recorded yet
                for scan in catalogue.scans():
                    for file in scan.path.rglob("*.png"):
                        kept.setdefault(file, file.stat().st_mtime_ns)
    assert kills == KILLS
    with Catalogue.open(experiment.catalogue_path) as catalogue:
        visits = list_visits(catalogue)
        assert len(visits) == 60
        assert all(one.state == "scanned" for one in visits)
        assert len({one.scan for one in visits}) == len(catalogue.scans()) == 60
        assert check(catalogue) == []
    assert len(list(experiment.scans_folder.iterdir())) == 60
    assert all(file.stat().st_mtime_ns == when for file, when in kept.items())  # no picture was taken again
