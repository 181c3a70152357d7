"""Experiment files: what they plan, and what is rejected."""

from dataclasses import replace
from pathlib import Path

import pytest

from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.files import save_scene
from rhizotwin.scenes.model import CapturePlan, Ring
from rhizotwin.scenes.specimens import SphereSpecimen
from rhizotwin.scenes.subject import Subject
from rhizotwin.timelapse.example import EXAMPLE
from rhizotwin.timelapse.experiment import load_experiment
from rhizotwin.timelapse.table import true_scene
from tests.rhizotwin.timelapse.conftest import small_scene


def test_example_plans_six_plants_for_ten_days(tmp_path: Path):
    (tmp_path / "e.toml").write_text(EXAMPLE)
    experiment = load_experiment(tmp_path / "e.toml")
    visits = experiment.visits()
    assert len(visits) == 60
    first = experiment.known_scene(experiment.member("P5"), visits[4][1])
    assert (first.subject.plant, first.subject.treatment, first.subject.day, first.subject.date) == ("P5", "low N", 5.0, "2026-12-01")
    assert first.strip.first_id == 4 * first.strip.rows * first.strip.columns
    assert first.solution.factors == {"N": 0.5}


@pytest.mark.parametrize(("rounds", "days"), [(7, ["01"]), (8, ["01", "08"])])
def test_phantom_is_scanned_every_week_until_the_last_round(make_experiment, rounds: int, days: list[str]):
    path = make_experiment(plants=1, rounds=rounds)
    path.write_text(path.read_text() + '[[plants]]\nname = "wires"\ncanister = 9\nevery_h = 168\n')
    experiment = load_experiment(path)
    due = [due for name, due in experiment.visits() if name == "wires"]
    assert due == [f"2026-12-{day}T09:00:00+00:00" for day in days]


def test_short_scans_lie_between_rounds_and_have_few_pictures(make_experiment):
    experiment = load_experiment(make_experiment(plants=2, rounds=2, schedule="tips_every_min = 25\nevery_h = 2\ntips_views = 4"))
    visits, member = [due for name, due in experiment.visits() if name == "P1"], experiment.member("P1")
    assert [due[11:16] for due in visits] == ["09:00", "09:25", "09:50", "10:15", "10:40", "11:00", "11:25", "11:50", "12:15", "12:40"]
    assert [experiment.is_short(member, due) for due in visits] == 2 * [False, True, True, True, True]
    assert experiment.scan_folder(member, visits[1]).name == "P1_day_000.0174_tips"
    assert len({experiment.scan_folder(member, due) for due in visits}) == 10
    assert experiment.most_late("P1", visits[0]) > 20 * experiment.most_late("P1", visits[1])
    wide = replace(experiment.base_scene(), plan=CapturePlan(rings=(Ring(views=40), Ring(views=20))))
    save_scene(wide, experiment.folder / "small.toml")
    assert [[ring.views for ring in experiment.known_scene(member, due).plan.rings] for due in visits[:2]] == [[40, 20], [4]]


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("canister = 2", "canister = 1", r"\[plants 2\] canister = 1: is already the canister of plant P1"),
        ('"P2"', '"P1"', r"is too similar to the name 'P1'"),
        ("canister = 2", "canister = 501", "must be between 1 and 500"),
        ("2026-12-01T09:00:00", "noon", "must be a date and time"),
        ("canister = 2", 'canister = 2\nsown = "2027-01-01"', "must not be later than the first scan"),
        ("canister = 2", 'canister = 2\nsown = "0001-01-01"', "must not be more than 36500 days before the last scan"),
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
