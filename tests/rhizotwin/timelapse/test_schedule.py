"""Scans that begin late, and changes of the schedule between runs."""

from datetime import datetime
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from rhizotwin.catalogue.store import Catalogue
from rhizotwin.catalogue.visits import list_visits
from rhizotwin.rig.scanning.observer import Look, Observer
from rhizotwin.scenes.dataset import load_dataset
from rhizotwin.scenes.errors import UserError
from rhizotwin.timelapse.clocks import VirtualCalendar
from rhizotwin.timelapse.experiment import Experiment, Member, load_experiment
from rhizotwin.timelapse.runner import Listener, Outcome, Runner


def test_late_scans_are_missed(make_experiment):
    experiment = load_experiment(make_experiment(plants=1, rounds=3))
    calendar = VirtualCalendar(datetime.fromisoformat("2026-12-02T22:00:00+00:00"))
    outcome = Runner(experiment, calendar=calendar).run()
    assert outcome.scanned == 1
    assert [one.due_utc[:10] for one in outcome.missed] == ["2026-12-01", "2026-12-02"]
    assert {one.note for one in outcome.missed} == {"the scan was not started in time"}


def run_slowly(experiment: Experiment, hours: float, **callbacks: Any) -> Outcome:
    """Run an experiment in which a person takes hours to put each canister on the table."""
    calendar = VirtualCalendar(experiment.start_utc)

    def change(member: Member, _reason: str) -> None:
        calendar.advance(3600.0 * hours)
        runner.table.put(member.canister)

    runner = Runner(experiment, listener=Listener(**callbacks), changer=SimpleNamespace(change=change), calendar=calendar)
    return runner.run()


def test_canister_that_comes_too_late_is_not_scanned(make_experiment):
    experiment = load_experiment(make_experiment(plants=1, rounds=1))
    (missed,) = run_slowly(experiment, 71.0).missed
    assert missed.note == "the scan was not started in time"
    assert not experiment.scans_folder.exists()


class Interruption(Observer):
    """Ctrl-C after the first picture."""

    def on_look(self, look: Look) -> None:
        """Interrupt the scan."""
        raise KeyboardInterrupt(look.frame.file)


@pytest.mark.parametrize(("hours", "day", "date"), [(10.0, 0.0, "2026-12-01"), (36.0, 1.5, "2026-12-02")])
def test_late_scan_has_the_date_and_age_at_its_start(make_experiment, hours: float, day: float, date: str):
    experiment = load_experiment(make_experiment(plants=1, rounds=1, schedule="late_h = 100"))
    with pytest.raises(KeyboardInterrupt):
        run_slowly(experiment, hours, observer=Interruption())
    assert run_slowly(experiment, 70.0).scanned == 1  # continued on another day
    dataset = load_dataset(experiment.scans_folder / "P1_day_000.00")
    assert dataset.origin["complete"]
    assert (dataset.scene.subject.day, dataset.scene.subject.date) == (day, date)


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


def test_plant_that_is_removed_is_no_longer_scanned(make_experiment):
    path = make_experiment(plants=2, rounds=2)
    calendar = VirtualCalendar(datetime.fromisoformat("2026-12-02T08:00:00+00:00"))
    first_round_missed = Listener(stop=lambda: calendar.now().hour > 8)
    Runner(load_experiment(path), calendar=calendar, listener=first_round_missed).run()
    text = path.read_text()
    path.write_text(text[: text.rindex("[[plants]]")])
    changed = "the schedule has changed: removed 1 planned scan that had not begun"
    assert planned(path) == (["2026-12-01T09", "2026-12-01T09", "2026-12-02T09"], [changed])
