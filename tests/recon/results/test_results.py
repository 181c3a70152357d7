"""Results: shapes divided between plants, reasons why results are not reliable, and traits of folders."""

import csv
import json
from dataclasses import replace
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
import trimesh

from rhizotwin.experiment.measured import read_all
from rhizotwin.recon.results import by_plant, divide_by_plant, reasons, result_traits
from rhizotwin.recon.results.assessments import assess
from rhizotwin.recon.results.parts import Json, Leaves, Mesh
from rhizotwin.recon.roots.plants import PlantedRoots
from rhizotwin.recon.uncertainty import checks
from rhizotwin.recon.uncertainty.budget import Term
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.plants import Plant
from rhizotwin.scenes.rsml import Root
from rhizotwin.scenes.subject import Subject
from rhizotwin.scenes.traits import measure_traits
from rhizotwin.scoring.score_plants import compare_plants
from rhizotwin.scoring.score_traits import compare_traits
from rhizotwin.stored import stored_traits
from rhizotwin.stored.load import load_result
from tests.recon.strings import root

A, B = Plant(plant="A", at_mm=(-10.0, 0.0), treatment="low N"), Plant(plant="B", at_mm=(10.0, 0.0))
WHOLE = Subject(species="Raphanus sativus", day=5.0)
ROOTS = tuple(replace(root((x, 0, -10), (x, 0, z), diameters=(1, 1)), plant=plant) for x, z, plant in ((-10, -30, "A"), (10, -50, "B")))
WATER = Term.symmetric("water", 6.0, "the refractive index")
TRUSTED = {"volume_trusted": True, "volume_verdict": "", "volume_budget": [{}], "volume_mm3": 60.0, "volume_interval_mm3": [60.0, 68.0]}
MISSING = Term(name="missing roots", less_mm3=0.0, more_mm3=8.0, why="coverage far from all tubes")


def divided(*terms: Term, is_open: bool = False) -> tuple[by_plant.PlantResult, ...]:
    """Divide a shape of two cuboids, 20 and 40 mm long, whose volumes are as 1 to 2."""
    low = np.array([[x, 0, -k] for x, count in ((-10, 20), (10, 40)) for k in range(11, 11 + count)], np.int32)
    filled = {"size": np.ones(60, np.int32), "occupancy": np.full(60, 0.5, np.float32)}
    leaves = Leaves(low=low, **filled, origin_mm=np.array([-0.5, -0.5, 0.0]), voxel_mm=1.0)
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
    small, big = (assess(TRUSTED, one.traits, volume_interval_mm3=one.volume_interval_mm3)["volume_mm3"] for one in (a, b))
    assert (small.verdict, small.codes, big.verdict) == ("not reliable", ("wide_interval",), "reliable")


def test_an_unreliable_length_is_not_reliable_for_plants() -> None:
    length = {"name": "total_length_mm", "value": 60.0, "interval": [40.0, 130.0], "trusted": False, "verdict": "many roots are hidden"}
    tips = {"name": "tips", "value": 2, "interval": [2.0, 2.0], "trusted": True, "verdict": ""}
    one = divided()[0]
    every = assess(TRUSTED | {"estimates": [length, tips]}, one.traits, volume_interval_mm3=one.volume_interval_mm3)
    found = every["total_length_mm"]
    assert (found.verdict, found.reason, found.interval) == ("not reliable", "many roots are hidden", None)
    assert found.codes == ("wide_interval",)
    assert every["tips"].verdict == "no interval"  # its interval is that of both plants


def test_tables_and_files_have_a_row_a_plant(scan, tmp_path: Path) -> None:
    made = scan()
    found = replace(load_result(made.result), plants=divided())
    found.save(tmp_path / "two")
    assert load_result(tmp_path / "two").plants == found.plants
    read = read_all([tmp_path / "two"])
    assert [(one.subject.plant, one.traits["volume"]) for one in read] == [("A", pytest.approx(20.0)), ("B", pytest.approx(40.0))]
    summary = json.loads((tmp_path / "two" / "result.json").read_text())
    rows = csv.DictReader(stored_traits.spreadsheet([("two", summary, found.measured)]).splitlines())
    assert [(row["plant"], float(row["volume_mm3"])) for row in rows] == [("A", pytest.approx(20.0)), ("B", pytest.approx(40.0))]
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


TERM = {"name": "views disagree", "less_mm3": 300.0, "more_mm3": 10.0, "why": "views disagree"}


def summary(**changes: Any) -> Json:
    """Return what the codes are derived from, of a volume that is refused for no known reason."""
    found = {
        "volume_trusted": False,
        "volume_budget": [TERM | {"less_mm3": 50.0}, TERM | {"name": "scale", "less_mm3": 20.0}],
        "volume_mm3": 1000.0,
        "volume_interval_mm3": [950.0, 1050.0],
        "checks": [],
        "settings": {},
        "views": [{"used": True}] * 12,
    }
    return found | changes


@pytest.mark.parametrize(
    ("changes", "codes"),
    [
        ({"volume_trusted": True}, ()),
        ({"volume_budget": []}, ("no_uncertainty",)),
        ({"checks": [{"name": "resolution", "state": "bad"}, {"name": "motion", "state": "fair"}]}, ("coarse_pictures",)),
        ({"views": [{"used": True}] * 7 + [{"used": False}]}, ("few_views",)),
        ({"volume_interval_mm3": [700.0, 1010.0], "volume_budget": [TERM]}, ("wide_interval", "high_views_disagree")),
        ({"volume_interval_mm3": [700.0, 1010.0], "volume_budget": [TERM], "settings": {"trust": {"widest": 0.4}}}, ("other",)),
        ({}, ("other",)),
    ],
    ids=["trusted", "baseline", "check", "views", "interval", "wider limit", "unknown"],
)
def test_codes_of_a_volume(changes: dict[str, Any], codes: tuple[str, ...]) -> None:
    assert reasons.reasons_for_volume(summary(**changes)) == codes


def test_codes_of_an_estimate() -> None:
    own = {"trusted": False, "value": 100.0, "interval": [60.0, 110.0]}
    assert reasons.reasons_for_estimate(summary(volume_trusted=True), own) == ("wide_interval",)
    assert reasons.reasons_for_estimate(summary(volume_budget=[]), own | {"interval": [90.0, 110.0]}) == ("no_uncertainty",)
    assert reasons.reasons_for_estimate(summary(volume_trusted=True), own | {"interval": [90.0, 110.0]}) == ("thin_roots",)
    assert reasons.reasons_for_estimate(summary(), own | {"trusted": True}) == ()


def test_every_check_has_a_code() -> None:
    assert set(reasons.OF_CHECK) == set(get_args(checks.Name)) - {"forks"}  # they concern no volume, and are never bad


THICK = root((0, 0, -10), (0, 0, -50), diameters=(4, 4))
THIN = root((0, 0, -30), (30, 0, -30), order=1, parent=0)


def surface_mm2(mesh: trimesh.Trimesh, *roots: Root) -> float:
    extents_mm = np.zeros(3), np.ones(3)
    return result_traits.measure_shape(Mesh.of(mesh), roots, volume_mm3=500.0, finest_mm=0.14, extents_mm=extents_mm).surface_mm2


def test_thin_roots_are_measured_as_tubes_thick_ones_on_the_mesh():
    organ = trimesh.creation.cylinder(radius=2.0, height=40.0, sections=256)
    organ.apply_translation([0.0, 0.0, -30.0])
    eaten = trimesh.creation.cylinder(radius=0.05, height=28.0, sections=8)  # what is left of the thin root in a mesh
    eaten.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2.0, [0.0, 1.0, 0.0]))
    eaten.apply_translation([16.0, 0.0, -30.0])
    thick = 2.0 * np.pi * 2.0 * 42.0
    assert surface_mm2(organ, THICK) == pytest.approx(thick, rel=1e-3)
    assert surface_mm2(organ + eaten, THICK, THIN) == pytest.approx(thick + 2.0 * np.pi * 0.15 * 28.0, rel=5e-3)


def test_errors_of_traits():
    skin = np.concatenate([THICK.points_mm, THIN.points_mm, [[0.0, 9.0, -20.0]]])
    true = measure_traits([THICK, THIN], skin, volume_mm3=500.0, surface_mm2=500.0)
    bent = root((0, 0, -30), (30, 0, -60), order=1, parent=0)
    found = measure_traits([THICK, bent], skin, volume_mm3=510.0, surface_mm2=500.0)
    scores = compare_traits(found, true)
    assert scores["volume"].error == pytest.approx(0.02)
    assert (scores["angle_to_parent"].error, scores["angle_to_parent"].error_unit) == (pytest.approx(-45.0, abs=1e-6), "deg")
    assert scores["tips"].error == compare_traits(true, true)["length_by_depth"].error == 0.0
    # 20 mm of the lateral have left the bin of depth 20-30 (a third of its 42.4 mm stays), and 12.4 mm are new
    assert scores["length_by_depth"].error == pytest.approx(0.5 * ((30.0 - 10.0 * np.sqrt(2.0)) + 20.0 * np.sqrt(2.0)) / 70.0)
    none = compare_traits(measure_traits([], skin, volume_mm3=510.0, surface_mm2=500.0), true)
    assert none["tips"].error is none["length_by_depth"].error is None
