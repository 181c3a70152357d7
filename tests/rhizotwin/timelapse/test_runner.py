"""Runs of small experiments on the emulated rig, in virtual time: canisters, faults, late scans, and changes of the schedule."""

import errno
import os
import re
import shutil
import signal
import sqlite3
import subprocess
import sys
import time
from datetime import datetime
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import pytest

from rhizotwin.catalogue.store import Catalogue
from rhizotwin.catalogue.verify import check
from rhizotwin.catalogue.visits import list_visits
from rhizotwin.rig.errors import UnsafeError
from rhizotwin.rig.scanning.observer import Observer
from rhizotwin.scenes.dataset import load_dataset
from rhizotwin.scenes.errors import UserError
from rhizotwin.timelapse import clocks
from rhizotwin.timelapse.changers import CarouselChanger, PersonChanger
from rhizotwin.timelapse.clocks import VirtualCalendar
from rhizotwin.timelapse.experiment import Experiment, Member, load_experiment
from rhizotwin.timelapse.runner import Listener, Outcome, Runner
from tests.rhizotwin.timelapse.conftest import write_experiment

ROOT = Path(__file__).resolve().parents[3]
SCANS = 9
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
    lock = experiment.scans_folder / "P1_day_000.00" / ".rhizotwin-lock"
    lock.write_text("{}")  # of a run that was killed after the scan
    assert Runner(experiment).run().scanned == 4
    assert not lock.exists()
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
    first, unknown, none, _, other = questions
    assert first == "Put canister 1 (plant P1) on the turntable, then press Enter: "
    assert "(APRILTAG_36h11 markers 1" in unknown
    assert "could not be read" in none
    assert "is P1 instead of P2" in other
    assert ([one.plant for one in outcome.missed], outcome.scanned) == (["P1"], 1)
    assert "matches no plant" in outcome.missed[0].note
    assert {path.parts[-3] for path in experiment.scans_folder.rglob("*.png")} == {"P2_day_000.00"}  # nothing is left of P1


def test_short_scans_follow_without_a_person(make_experiment):
    """The canister remains on the table; the short scans are not reconstructed."""
    experiment, questions, lines = load_experiment(make_experiment(plants=1, rounds=1, schedule="tips_every_min = 480")), [], []

    def ask(question: str) -> str:
        runner.table.put(1)
        questions.append(question)
        return ""

    runner = Runner(experiment, listener=Listener(ask=ask, say=lines.append), changer=PersonChanger(ask))
    assert (runner.run().scanned, len(questions)) == (3, 1)
    with Catalogue.open(experiment.catalogue_path) as catalogue:
        assert [(one.path.name, one.day) for one in catalogue.scans()] == [
            ("P1_day_000.00", 0.0), ("P1_day_000.3333_tips", 0.3333), ("P1_day_000.6667_tips", 0.6667)
        ]  # fmt: skip
    assert any("reconstruction of 1 scan was skipped" in line for line in lines)


def test_carousel_that_is_blocked_once_is_tried_again(make_experiment):
    experiment = load_experiment(make_experiment(plants=1, rounds=1, schedule="pause_min = 1"))
    places, lines = list[int](), list[str]()

    def load(place: int) -> None:
        places.append(place)
        if len(places) == 1:
            raise UnsafeError("carousel: the carousel does not rotate; remove the obstacle and continue")
        runner.table.put(place)

    carousel = SimpleNamespace(describe=lambda: "blocked", load=load, **dict.fromkeys(("prepare", "unload", "close"), lambda: None))
    runner = Runner(experiment, listener=Listener(say=lines.append), changer=CarouselChanger(carousel))
    outcome = runner.run()
    assert (outcome.scanned, outcome.missed, places) == (1, (), [1, 1])
    assert any("attempt 1 of 3 failed: carousel: the carousel does not rotate" in line for line in lines)


def test_faults_that_end_the_run_and_not_the_scan(make_experiment, monkeypatch: pytest.MonkeyPatch):
    experiment = load_experiment(make_experiment(plants=1, rounds=1))
    with pytest.raises(UserError, match="needs a person who puts its canister"):
        Runner(experiment, changer=PersonChanger(None)).run()
    faults: list[tuple[str, Any]] = [("shutil.disk_usage", lambda _: SimpleNamespace(total=2**40, free=2**24))]
    for cause in (OSError(errno.ENOSPC, "full"), sqlite3.OperationalError("database is locked")):
        error = UserError("free some space")
        error.__cause__ = cause
        faults.append(("rhizotwin.steps.rigs.take_scan", Mock(side_effect=error)))
    for name, function in faults:
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
    for delay_s in (0.0, 0.75, 1.5):  # after the first change of each run
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


def test_late_scans_are_missed_but_not_by_a_wrong_clock(make_experiment):
    path, lines = make_experiment(plants=1, rounds=3), list[str]()
    wrong, right = (VirtualCalendar(datetime.fromisoformat(f"{day}T22:00:00+00:00")) for day in ("2027-01-01", "2026-12-02"))
    assert len(Runner(load_experiment(path), calendar=wrong).run().missed) == 3
    outcome = Runner(load_experiment(path), calendar=right, listener=Listener(say=lines.append)).run()
    assert outcome.scanned == 1
    assert [one.due_utc[:10] for one in outcome.missed] == ["2026-12-01", "2026-12-02"]
    assert "shows 2026-12-02 22:00 UTC, but the catalogue has entries of 2027-01-01T22:00" in lines[0]


def test_steps_of_the_clock_do_not_move_the_schedule(monkeypatch: pytest.MonkeyPatch):
    wall, up_s, said = VirtualCalendar(datetime.fromisoformat("2026-12-01T09:00:00+00:00")), [7200.0], list[str]()
    monkeypatch.setattr(clocks, "datetime", SimpleNamespace(now=lambda _: wall.now()))
    monkeypatch.setattr(clocks, "uptime_s", lambda: up_s[0])
    calendar, shown = clocks.SystemCalendar(said.append), list[str]()
    for step_s in (0.0, 30.0, -86400.0, 86400.0 * 31, -86400.0 * 30):
        wall.advance(step_s + 3600.0)
        up_s[0] += 3600.0
        shown.append(f"{calendar.now():%d %H:%M:%S}")
    assert shown == ["01 10:00:00", "01 11:00:30", "01 12:00:30", "01 13:00:30", "01 14:00:30"]
    assert [re.findall(r"-(\d\d) (\d\d):", line) for line in said] == [[("01", "12"), ("30", "12")], [("01", "13"), ("31", "13")]]
    up_s[0] = 60.0
    calendar = clocks.SystemCalendar(said.append)
    wall.advance(86400.0)  # a Raspberry Pi learns the time soon after it was switched on
    assert calendar.now() == wall.now()


def run_slowly(experiment: Experiment, hours: float, **callbacks: Any) -> Outcome:
    """Run an experiment in which a person takes hours to put each canister on the table."""
    calendar = VirtualCalendar(experiment.start_utc)

    def change(member: Member, _reason: str) -> None:
        calendar.advance(3600.0 * hours)
        runner.table.put(member.canister)

    runner = Runner(experiment, listener=Listener(**callbacks), changer=SimpleNamespace(change=change), calendar=calendar)
    return runner.run()


Interruption = type("Interruption", (Observer,), {"on_look": Mock(side_effect=KeyboardInterrupt)})
"""Ctrl-C after the first picture."""


def test_late_scan_has_the_date_and_age_at_its_start(make_experiment):
    experiment = load_experiment(make_experiment(plants=1, rounds=1, schedule="late_h = 100"))
    with pytest.raises(KeyboardInterrupt):
        run_slowly(experiment, 36.0, observer=Interruption())
    assert run_slowly(experiment, 70.0).scanned == 1  # continued on another day
    dataset = load_dataset(experiment.scans_folder / "P1_day_000.00")
    assert (dataset.scene.subject.day, dataset.scene.subject.date) == (1.5, "2026-12-02")


def planned(path: Path) -> tuple[list[str], list[str]]:
    """Return the planned times in the catalogue of an experiment, and the lines of output."""
    experiment, lines = load_experiment(path), list[str]()
    Runner(experiment, listener=Listener(say=lines.append)).prepare()
    with Catalogue.open(experiment.catalogue_path) as catalogue:
        return [one.due_utc[:13] for one in list_visits(catalogue)], lines


def test_schedule_changes_but_does_not_move_once_begun(make_experiment):
    path = make_experiment(plants=1, rounds=3)
    assert planned(path) == (["2026-12-01T09", "2026-12-02T09", "2026-12-03T09"], [])
    path.write_text(path.read_text().replace("T09:00", "T10:00").replace("rounds = 3", "rounds = 2"))
    changed = "the schedule has changed: removed 3 planned scans that had not begun"
    assert planned(path) == (["2026-12-01T10", "2026-12-02T10"], [changed])
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
