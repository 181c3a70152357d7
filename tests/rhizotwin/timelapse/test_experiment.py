"""Experiment files: what they plan, and what is rejected."""

import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest

from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.files import save_scene
from rhizotwin.scenes.specimens import SphereSpecimen
from rhizotwin.scenes.subject import Subject
from rhizotwin.timelapse.example import EXAMPLE
from rhizotwin.timelapse.experiment import EVERY_H, load_experiment
from rhizotwin.timelapse.table import true_scene
from tests.rhizotwin.timelapse.conftest import small_scene


def test_example_plans_six_plants_for_ten_days(tmp_path: Path):
    (tmp_path / "e.toml").write_text(EXAMPLE)
    experiment = load_experiment(tmp_path / "e.toml")
    visits = experiment.visits()
    assert len(visits) == 60
    assert [name for name, _ in visits[:7]] == ["P1", "P2", "P3", "P4", "P5", "P6", "P1"]
    first, last = (experiment.known_scene(experiment.member("P5"), visits[k][1]) for k in (4, 58))
    assert (first.subject.plant, first.subject.treatment, first.subject.day, first.subject.date) == ("P5", "low N", 5.0, "2026-12-01")
    assert (last.subject.day, last.subject.date) == (14.0, "2026-12-10")
    assert first.strip.first_id == 4 * first.strip.rows * first.strip.columns
    assert first.solution.factors == {"N": 0.5}
    assert len({experiment.scan_folder(experiment.member(name), due) for name, due in visits}) == 60


@pytest.mark.parametrize(("rounds", "days"), [(7, ["01"]), (8, ["01", "08"]), (10, ["01", "08"]), (15, ["01", "08", "15"])])
def test_phantom_is_scanned_every_week_until_the_last_round(make_experiment, rounds: int, days: list[str]):
    path = make_experiment(plants=1, rounds=rounds)
    path.write_text(path.read_text() + '[[plants]]\nname = "wires"\ncanister = 9\nevery_h = 168\n')
    experiment = load_experiment(path)
    due = [due for name, due in experiment.visits() if name == "wires"]
    assert due == [f"2026-12-{day}T09:00:00+00:00" for day in days]


def test_each_scan_has_a_folder_at_the_shortest_interval(make_experiment):
    path = make_experiment(plants=1, rounds=500, schedule=f"every_h = {EVERY_H[0]}")
    experiment = load_experiment(path)
    visits = experiment.visits()
    assert len({experiment.scan_folder(experiment.member(name), due) for name, due in visits}) == len(visits) == 500


@pytest.mark.skipif(sys.platform == "win32", reason="the time zone is set by a variable")
def test_dates_agree_with_days_when_the_clock_changes(make_experiment, monkeypatch: pytest.MonkeyPatch):
    """In Berlin the clock is set back on 25 October 2026, and a scan at 00:30 would then be at 23:30 of the day before."""
    path = make_experiment(plants=1, rounds=4)
    path.write_text(path.read_text().replace("2026-12-01T09:00:00+00:00", "2026-10-24T00:30"))
    monkeypatch.setenv("TZ", "Europe/Berlin")
    time.tzset()
    try:
        experiment = load_experiment(path)
        subjects = [experiment.known_scene(experiment.member(name), due).subject for name, due in experiment.visits()]
        assert [(one.day, one.date) for one in subjects] == [(float(day), f"2026-10-{24 + day}") for day in range(4)]
    finally:
        monkeypatch.undo()
        time.tzset()


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("canister = 2", "canister = 1", r"\[plants 2\] canister = 1: is already the canister of plant P1"),
        ('"P2"', '"P1"', r"is too similar to the name 'P1'"),
        ('"P2"', '""', "must not be empty"),
        ("canister = 2", "canister = 27", "enough for 26 strips of 22"),
        ("rounds = 2", "rounds = 0", "rounds = 0"),
        ("2026-12-01T09:00:00", "noon", "must be a date and time"),
        ("[twin]", "[twins]", "unknown key"),
        ("canister = 2", 'canister = 2\nsown = "2027-01-01"', "must not be later than the first scan"),
        ("canister = 2", 'canister = 2\nsown = "soon"', "must be a date"),
        ("canister = 2", f"canister = 2\nreplicate = {10**30}", "replicate"),
        ("canister = 2", 'canister = 2\nsown = "0001-01-01"', "must not be more than 36500 days before the last scan"),
        ("canister = 2", "canister = 2\nevery_h = 0.1", "every_h = 0.1"),
        ("2026-12-01T09:00:00", "9999-12-31T23:00:00", "between the years 1 and 9999"),
        ('scene = "small.toml"', 'scene = "small.toml"\nscans = "a\\u0000b"', "printable"),
        ('scene = "small.toml"', 'scene = "small.toml"\ncatalogue = "x.db"', "must end with .rhizotwin"),
    ],
)
def test_mistakes_are_named(make_experiment, old: str, new: str, words: str):
    path = make_experiment()
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(UserError, match=words):
        load_experiment(path)


def test_files_are_relative_to_the_experiment_file(make_experiment, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    path = make_experiment(plants=1)
    (tmp_path / "mine.toml").write_text("[disturbances]\ncanister_tilt_deg = 2.5\n")
    save_scene(replace(small_scene(3), specimen=SphereSpecimen(diameter_mm=7.0)), tmp_path / "ball.toml")
    path.write_text(path.read_text().replace('"clean"', '"mine.toml"') + 'scene = "ball.toml"\n')
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    experiment = load_experiment(path)
    assert experiment.disturbances().canister_tilt_deg == 2.5
    assert true_scene(experiment, experiment.plants[0], Subject(plant="P1", day=1.0)).specimen.diameter_mm == 7.0
