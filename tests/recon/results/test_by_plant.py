"""A shape divided between two plants, written and read."""

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from rhizotwin.experiment.measured import read_all
from rhizotwin.recon.results import by_plant, divide_by_plant
from rhizotwin.recon.results.assessments import assess
from rhizotwin.recon.results.parts import Leaves, Mesh
from rhizotwin.recon.roots.plants import PlantedRoots
from rhizotwin.recon.uncertainty.budget import Term
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.plants import Plant
from rhizotwin.scenes.rsml import Root
from rhizotwin.scenes.subject import Subject
from rhizotwin.scoring.score_plants import compare_plants
from rhizotwin.stored import stored_traits
from rhizotwin.stored.load import load_result

A, B = Plant(plant="A", at_mm=(-10.0, 0.0), treatment="low N"), Plant(plant="B", at_mm=(10.0, 0.0))
WHOLE = Subject(species="Raphanus sativus", day=5.0)


def root(x: float, long_mm: float, plant: str) -> Root:
    points = np.stack([np.full(40, x), np.zeros(40), np.linspace(-10.0, -10.0 - long_mm, 40)], axis=1)
    return Root(points_mm=points, diameters_mm=np.full(40, 1.0), order=0, parent=-1, plant=plant)


ROOTS = root(-10.0, 20.0, "A"), root(10.0, 40.0, "B")


WATER = Term.symmetric("water", 6.0, "the refractive index")
MISSING = Term(name="missing roots", less_mm3=0.0, more_mm3=8.0, why="coverage far from all tubes")


def divided(*terms: Term, is_open: bool = False) -> tuple[by_plant.PlantResult, ...]:
    """Divide a shape of two cuboids, 20 and 40 mm long, whose volumes are as 1 to 2."""
    low = np.array([[x, 0, -k] for x, count in ((-10, 20), (10, 40)) for k in range(11, 11 + count)], np.int32)
    ones, half = np.ones(60, np.int32), np.full(60, 0.5, np.float32)
    leaves = Leaves(low=low, size=ones, occupancy=half, origin_mm=np.array([-0.5, -0.5, 0.0]), voxel_mm=1.0)
    boxes = [trimesh.creation.box((1.0, 1.0, h)).apply_translation((x, 0.0, -10.0 - h / 2)) for x, h in ((-10, 20), (10, 40))]
    surface = Mesh.of(trimesh.util.concatenate(boxes))
    shape = divide_by_plant.Shape(leaves=leaves, surface=surface, finest_mm=1.0, volume_mm3=60.0, terms=terms or (WATER,))
    return divide_by_plant.measure(shape, PlantedRoots(ROOTS, (False, is_open), ()), (A, B), WHOLE)


def test_every_part_is_of_the_plant_whose_root_is_nearest() -> None:
    a, b = divided()
    assert (a.volume_mm3, b.volume_mm3) == pytest.approx((20.0, 40.0))
    assert a.volume_interval_mm3 == pytest.approx((18.0, 22.0))
    assert (a.traits.total_length_mm, b.traits.total_length_mm) == pytest.approx((20.0, 40.0))
    assert a.traits.width_mm < 2.0  # of its own part of the surface, not of both
    assert str(a.subject) == "A (Raphanus sativus), treatment low N, day 5"
    assert b.subject.treatment == ""


def test_what_may_be_anothers_is_in_the_intervals_of_both() -> None:
    a, b = divided(is_open=True)
    assert a.volume_interval_mm3 == pytest.approx((18.0, 1.1 * 60.0))
    assert b.volume_interval_mm3 == pytest.approx((0.0, 44.0))
    assert b.open_mm == pytest.approx(40.0)
    said = divide_by_plant.warnings(PlantedRoots(ROOTS, (False, True), ("C",)), (a, b))
    assert "plant C" in said[0]
    assert "67 %" in said[1]


def test_missing_roots_may_all_be_of_one_plant() -> None:
    """A tenth of a big plant is half of a small one beside it: that is too wide for a volume to be reliable."""
    a, b = divided(MISSING)
    assert (a.volume_interval_mm3, b.volume_interval_mm3) == (pytest.approx((20.0, 28.0)), pytest.approx((40.0, 48.0)))
    summary = {"volume_trusted": True, "volume_verdict": "", "volume_budget": [{}], "volume_mm3": 60.0, "volume_interval_mm3": [60.0, 68.0]}
    small, big = (assess(summary, one.traits, volume_interval_mm3=one.volume_interval_mm3)["volume_mm3"] for one in (a, b))
    assert (small.verdict, small.codes, big.verdict) == ("not reliable", ("wide_interval",), "reliable")


def test_an_unreliable_length_of_the_scan_is_not_reliable_for_its_plants() -> None:
    length = {"name": "total_length_mm", "value": 60.0, "interval": [40.0, 130.0], "trusted": False, "verdict": "many roots are hidden"}
    tips = {"name": "tips", "value": 2, "interval": [2.0, 2.0], "trusted": True, "verdict": ""}
    summary = {
        "volume_trusted": True,
        "volume_verdict": "",
        "volume_budget": [{}],
        "volume_mm3": 60.0,
        "volume_interval_mm3": [54.0, 66.0],
        "estimates": [length, tips],
    }
    one = divided()[0]
    found = assess(summary, one.traits, volume_interval_mm3=one.volume_interval_mm3)
    for trait in ("total_length_mm", "specific_root_length_m_per_g"):
        assert (found[trait].verdict, found[trait].reason, found[trait].interval) == ("not reliable", "many roots are hidden", None)
        assert found[trait].codes == ("wide_interval",)
    assert found["tips"].verdict == "not assessed"  # its interval is that of both plants


def test_tables_and_files_have_a_row_a_plant(scan, tmp_path: Path) -> None:
    made = scan()
    found = replace(load_result(made.result), plants=divided())
    found.save(tmp_path / "two")
    assert load_result(tmp_path / "two").plants == found.plants
    read = read_all([tmp_path / "two"])
    assert [(one.subject.plant, one.traits["volume"]) for one in read] == [("A", pytest.approx(20.0)), ("B", pytest.approx(40.0))]
    summary = json.loads((tmp_path / "two" / "result.json").read_text())
    rows = list(csv.DictReader(stored_traits.spreadsheet([("two", summary, found.measured)]).splitlines()))
    assert [row["plant"] for row in rows] == ["A", "B"]
    assert [float(row["volume_mm3"]) for row in rows] == pytest.approx([20.0, 40.0])
    table = list(csv.DictReader((tmp_path / "two" / "traits.csv").read_text().splitlines()))
    assert [row["plant"] for row in table if row["trait"] == "total_length_mm"] == ["", "A", "B"]
    summary["plants"][0]["at_mm"] = "here"
    with pytest.raises(UserError, match="at_mm"):
        by_plant.from_summary(summary, "result.json")


def test_each_plant_is_scored_against_its_own_truth() -> None:
    truth = {"A": {"volume_mm3": 25.0}, "B": {"volume_mm3": 40.0}}
    a, b = compare_plants(divided(), [ROOTS[0], replace(ROOTS[1], plant="A")], truth, ROOTS)
    assert a.volume_error == pytest.approx(-0.2)
    assert not a.interval_holds_truth
    assert a.rightly_given == pytest.approx(1.0 / 3.0, abs=0.02)  # two thirds of what was given to A lie on B
    assert b.length_mm == 0.0
    assert b.interval_holds_truth
