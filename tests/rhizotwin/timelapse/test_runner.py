"""Runs of small experiments on the emulated rig, in virtual time."""

import errno
import os
import random
import shutil
import signal
import sqlite3
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from rhizotwin.batches.jobs import Job
from rhizotwin.batches.run import Batch
from rhizotwin.catalogue import adding
from rhizotwin.catalogue.store import Catalogue
from rhizotwin.catalogue.verify import check
from rhizotwin.catalogue.visits import list_visits
from rhizotwin.rig.errors import UnsafeError
from rhizotwin.rig.scanning.observer import Look, Observer
from rhizotwin.scenes import files
from rhizotwin.scenes.dataset import load_dataset
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import CapturePlan, Ring
from rhizotwin.timelapse.changers import CarouselChanger, PersonChanger
from rhizotwin.timelapse.clocks import VirtualCalendar
from rhizotwin.timelapse.experiment import Experiment, Member, load_experiment
from rhizotwin.timelapse.reconstruction import Reconstructor
from rhizotwin.timelapse.runner import Listener, Outcome, Runner
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


def test_late_scans_are_missed(make_experiment):
    experiment = load_experiment(make_experiment(plants=1, rounds=3))
    calendar = VirtualCalendar(datetime.fromisoformat("2026-12-02T22:00:00+00:00"))
    outcome = Runner(experiment, calendar=calendar).run()
    assert outcome.scanned == 1
    assert [(one.due_utc[:10], one.note) for one in outcome.missed] == [
        ("2026-12-01", "the scan was not started in time"),
        ("2026-12-02", "the scan was not started in time"),
    ]


class SlowHand:
    """A person who takes hours to put the canister on the emulated table."""

    def __init__(self, calendar: VirtualCalendar, hours: float) -> None:
        self._calendar, self._hours = calendar, hours
        self.runner: Runner | None = None

    def change(self, member: Member, _reason: str, /) -> None:
        """Put the canister on the table after some hours."""
        self._calendar.advance(3600.0 * self._hours)
        assert self.runner is not None
        assert isinstance(self.runner.table, EmulatedTable)
        self.runner.table.put(member.canister)


def run_slowly(experiment: Experiment, hours: float, **callbacks: Any) -> Outcome:
    calendar = VirtualCalendar(experiment.start_utc)
    hand = SlowHand(calendar, hours)
    hand.runner = Runner(experiment, listener=Listener(**callbacks), changer=hand, calendar=calendar)
    return hand.runner.run()


def test_canister_that_comes_too_late_is_not_scanned(make_experiment):
    experiment = load_experiment(make_experiment(plants=1, rounds=1))
    (missed,) = run_slowly(experiment, 71.0).missed
    assert missed.note == "the scan was not started in time"
    assert not experiment.scans_folder.exists()


def test_attempt_that_comes_too_late_is_not_made(make_experiment):
    experiment = load_experiment(make_experiment(plants=1, rounds=1, schedule="pause_min = 800"))
    carousel = Blocked()
    carousel.runner = Runner(experiment, changer=CarouselChanger(carousel))
    (missed,) = carousel.runner.run().missed
    assert carousel.loads == 1
    assert "the carousel does not rotate" in missed.note


@pytest.mark.parametrize(("hours", "day", "date"), [(10.0, 0.0, "2026-12-01"), (36.0, 1.5, "2026-12-02")])
def test_late_scan_has_the_date_and_age_at_its_start(make_experiment, hours: float, day: float, date: str):
    experiment = load_experiment(make_experiment(plants=1, rounds=1, schedule="late_h = 100"))
    with pytest.raises(KeyboardInterrupt):
        run_slowly(experiment, hours, observer=Interruption())
    assert run_slowly(experiment, 70.0).scanned == 1  # continued on another day
    dataset = load_dataset(experiment.scans_folder / "P1_day_000.00")
    assert dataset.origin["complete"]
    assert (dataset.scene.subject.day, dataset.scene.subject.date) == (day, date)


class Interruption(Observer):
    """Ctrl-C after the first picture."""

    def on_look(self, look: Look) -> None:
        """Interrupt the scan."""
        raise KeyboardInterrupt(look.frame.file)


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
        ("shutil.disk_usage", lambda _: shutil._ntuple_diskusage(2**40, 2**40, 2**24)),
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


def test_changed_plan_contradicts_the_catalogue(make_experiment):
    experiment = load_experiment(make_experiment(plants=2, rounds=1))
    Runner(experiment).prepare()
    (one, two) = experiment.plants
    swapped = replace(experiment, plants=(replace(one, treatment="low N"), two))
    with pytest.raises(UserError, match="treatment of plant P1 is control in the catalogue, but low N"):
        Runner(swapped).prepare()


def planned(path: Path) -> tuple[list[str], list[str]]:
    """Return the planned times in the catalogue of an experiment, and the lines of output."""
    experiment, lines = load_experiment(path), list[str]()
    Runner(experiment, listener=Listener(say=lines.append)).prepare()
    with Catalogue.open(experiment.catalogue_path) as catalogue:
        return [one.due_utc[:13] for one in list_visits(catalogue)], lines


def test_schedule_changes_before_its_first_scan(make_experiment):
    path = make_experiment(plants=1, rounds=3)
    assert planned(path) == (["2026-12-01T09", "2026-12-02T09", "2026-12-03T09"], [])
    path.write_text(path.read_text().replace("T09:00", "T10:00").replace("rounds = 3", "rounds = 2"))
    changed = "the schedule has changed: removed 3 planned scans that had not begun"
    assert planned(path) == (["2026-12-01T10", "2026-12-02T10"], [changed])


def test_begun_schedule_is_extended_and_shortened_but_not_moved(make_experiment):
    path = make_experiment(plants=1, rounds=2)
    with pytest.raises(KeyboardInterrupt):
        run_slowly(load_experiment(path), 0.0, observer=Interruption())
    text = path.read_text()
    for rounds in (3, 1):
        path.write_text(text.replace("rounds = 2", f"rounds = {rounds}"))
        assert len(planned(path)[0]) == rounds
    path.write_text(text.replace("T09:00", "T10:00"))
    with pytest.raises(UserError, match=r"P1 planned for 2026-12-01T09:00:00\+00:00 is scanning, but not in the schedule; restore start"):
        planned(path)


def test_growth_curves_are_written_if_an_earlier_run_was_killed_before(make_experiment, ball_result):
    experiment = load_experiment(make_experiment(plants=1, rounds=1))
    Runner(experiment).prepare()
    page = experiment.results_folder / "growth" / "growth.html"
    with Catalogue.open(experiment.catalogue_path) as catalogue:
        for day in (0.0, 1.0):
            result = ball_result(f"results/P1_{day:g}", subject={"plant": "P1", "treatment": "low N", "day": day})
            adding.add_result(catalogue, result)
        step = partial(Reconstructor(experiment, say=print).step, catalogue, stop=lambda: False)
        assert step()
        written = page.stat().st_mtime_ns
        assert not step()
        assert page.stat().st_mtime_ns == written
        (result / "result.json").touch()
        assert Reconstructor(experiment, say=print).step(catalogue, stop=lambda: False)
        assert page.stat().st_mtime_ns > written


class SlowBatch:
    """Reconstructions that take two hours of virtual time, unless they are stopped."""

    def __init__(self, calendar: VirtualCalendar) -> None:
        self._calendar = calendar
        self.began = list[str]()
        self.stopped = list[str]()

    def run(self, jobs: Sequence[Job], _: str, *, stop: Callable[[], bool], **__: object) -> Batch:
        """Let time pass minute by minute."""
        self.began += [job.name for job in jobs]
        for _minute in range(120):
            if stop():
                self.stopped += [job.name for job in jobs]
                return Batch(kept=(), done=(), failed=())
            self._calendar.advance(60.0)
        return Batch(kept=(), done=(), failed=tuple((job, "no roots") for job in jobs))


def test_reconstruction_does_not_delay_the_next_scan(make_experiment, monkeypatch: pytest.MonkeyPatch):
    experiment = load_experiment(make_experiment(plants=2, rounds=2, schedule="every_h = 1\nlate_h = 0.5"))
    calendar = VirtualCalendar(experiment.start_utc)
    batch = SlowBatch(calendar)
    monkeypatch.setattr("rhizotwin.catalogue.adding.is_sketch", lambda _: False)
    monkeypatch.setattr("rhizotwin.batches.run.run", batch.run)
    outcome = Runner(experiment, calendar=calendar).run()
    assert (outcome.scanned, outcome.missed) == (4, ())
    assert batch.stopped == ["P1_day_000.00"]
    assert sorted(batch.began[1:]) == ["P1_day_000.00", "P1_day_000.04", "P2_day_000.00", "P2_day_000.04"]


def test_reconstruction_that_would_take_too_long_is_not_begun(make_experiment, monkeypatch: pytest.MonkeyPatch):
    experiment = load_experiment(make_experiment(plants=1, rounds=1))
    batch = SlowBatch(VirtualCalendar(experiment.start_utc))
    monkeypatch.setattr("rhizotwin.catalogue.adding.is_sketch", lambda _: False)
    monkeypatch.setattr("rhizotwin.batches.run.run", batch.run)
    done = list[str]()
    Runner(experiment, listener=Listener(on_visit=lambda visit: done.append(visit.state), stop=lambda: "scanned" in done)).run()
    reconstructor = Reconstructor(experiment, say=print)
    with Catalogue.open(experiment.catalogue_path) as catalogue:
        stops = iter([False, True, True])
        assert reconstructor.step(catalogue, stop=lambda: next(stops), left_s=60.0)
        assert not reconstructor.step(catalogue, stop=lambda: False, left_s=1e-9)
        assert reconstructor.step(catalogue, stop=lambda: False, left_s=60.0)
    assert batch.began == ["P1_day_000.00"] * 2


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


@pytest.mark.slow
def test_rendered_scans_are_reconstructed(tmp_path: Path):
    """A radish on two days: results and the rig's numbers are in the catalogue, and each day has more root."""
    scene = files.load_scene("radish_day05b")
    plan = CapturePlan(rings=(Ring(views=16),))
    files.save_scene(replace(scene, camera=scene.camera.resized((400, 300)), plan=plan), tmp_path / "scene.toml")
    text = (
        'name = "radish"\nrig = "twin"\nscene = "scene.toml"\n[schedule]\nstart = "2026-12-01T09:00:00+00:00"\nrounds = 2\nevery_h = 72\n'
    )
    text += '[twin]\nfidelity = "render"\n[[plants]]\nname = "P1"\ncanister = 1\nsown = "2026-11-26"\n'
    (tmp_path / "e.toml").write_text(text)
    experiment = load_experiment(tmp_path / "e.toml")
    assert Runner(experiment).run().scanned == 2
    with Catalogue.open(experiment.catalogue_path) as catalogue:
        first, second = catalogue.results()
        assert (first.plants, first.day, second.day) == (("P1",), 5.0, 8.0)
        assert {"focal_scale", "panel_level", "canister_tilt_deg"} <= set(first.rig_numbers)
        lengths = dict(
            catalogue.rows("SELECT x.day, t.value FROM traits t JOIN results x ON x.id = t.result WHERE t.name = 'total_length'")
        )
        assert lengths[8.0] > lengths[5.0] > 0.0
        assert check(catalogue) == []
