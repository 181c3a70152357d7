"""The numbers of the ladder's table from chosen runs."""

import math

import pytest

from benchmarks import table
from benchmarks.cases import FAMILIES, ladder
from benchmarks.targets import TARGETS


@pytest.fixture(scope="module")
def chosen():
    return ladder(scenes=("printed_8ml", "radish_*", "fallen_plant", *FAMILIES))


@pytest.fixture
def records(chosen, record_of):
    """Return runs of the whole ladder: ours get worse with the profile, the thesis's volume is ten times the truth."""

    def one(case):
        error = {"clean": -0.02, "bench": 0.04, "harsh": 0.30}[case.pictures.profile] * (2.0 if case.pictures.scene.endswith("c") else 1.0)
        tips = 0.97 if case.pictures.scene.startswith("radish_day") else 0.77
        holds = case.pictures.profile != "harsh"
        return record_of(case, volume_error=9.0 if case.method == "thesis" else error, tips=tips, holds=holds)

    return [one(case) for case in chosen]


def by_key(records):
    return {line.key: line for line in table.lines(records)}


def test_numbers_of_groups(records):
    found = by_key(records)
    assert {key for key in TARGETS if key.startswith("ladder/")} <= found.keys()
    early = found["ladder/radish_day05-15/clean/volume_median"]
    assert (early.runs, early.value, early.verdict, early.thesis) == (9, pytest.approx(0.02), "yes", pytest.approx(9.0))
    assert found["ladder/radish_day05-15/clean/volume_worst"].value == pytest.approx(0.04)
    assert found["ladder/radish_day20-30/harsh/volume_worst"].verdict == ""  # no goal but the interval
    assert found["ladder/radish_day20-30/harsh/interval_holds"].verdict == "NO"
    assert found["ladder/plants/clean/tip_recall"].value == pytest.approx((18 * 0.97 + 0.77) / 19)
    assert found["ladder/plants/clean/tip_recall_worst"].value == pytest.approx(0.77)  # beside every mean stands the worst
    assert found["ladder/plants/clean/length_mean"].thesis is None
    assert found["ladder/thin_families/clean/volume_worst"].runs == 4 + 2  # one of them at two sizes more
    assert found["ladder/thin_families_one_ring/clean/volume_worst"].runs == 4
    assert found["ladder/plants_one_ring/bench/identity"].value == pytest.approx(0.95)
    assert found["ladder/thick_families/bench/volume_worst"].verdict == "yes"
    assert found["ladder/all/bench/interval_holds"].value == 1.0
    assert "ladder/fallen_plant/harsh/volume_worst" not in found
    part = [r for r in records if (r["case"]["scene"], r["case"]["method"], r["case"]["rings"]) == ("radish_day05a", "coverage", 2)]
    assert {line.group for line in table.lines(part)} == {"radish_day05-15", "plants", "all"}
    assert all(line.runs == 1 and line.thesis is None for line in table.lines(part))


def test_a_run_without_a_number_cannot_reach_the_goal(records):
    broken = next(r for r in records if (r["case"]["scene"], r["case"]["method"], r["case"]["rings"]) == ("radish_day10b", "coverage", 2))
    broken["score"]["volume_error"] = None
    broken["score"]["roots"] = None
    found = by_key(records)
    assert math.isnan(found["ladder/radish_day05-15/clean/volume_median"].value)
    assert found["ladder/radish_day05-15/clean/volume_worst"].verdict == "NO"
    assert found["ladder/plants/clean/length_mean"].verdict == "NO"
    assert "| none |" in table.markdown(table.lines(records), records)
