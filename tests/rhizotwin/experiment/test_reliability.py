"""Values that are not reliable stay out of tests and fits, and every consumer says how many and why."""

import csv
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rhizotwin.experiment import biomass, growth, growth_page, model_file
from rhizotwin.experiment.masses import read_masses
from rhizotwin.experiment.measured import exclusion_notes, read_all
from rhizotwin.recon.results import assessments
from rhizotwin.scenes import rsml, trait_table
from rhizotwin.scenes.errors import UserError
from rhizotwin.stored import result_files, stored_traits
from tests.roots import straight

HEAD = "result,plant,treatment,day,{0} (mm),{0}_low (mm),{0}_high (mm),{0}_verdict,volume (mm3),trusted\n".format("total_length")
LEAVES = "plant,treatment,day,leaves,leaf_area_mm2,ndvi\n" + "".join(
    f"p{k},{'ab'[k % 2]},{day},{day // 5 + 1},{day * (10.0 + k) / (1 + k % 2)},{(0.8 + 0.01 * k) / (1 + k % 2)}\n"
    for k in range(6)
    for day in (5, 10)
)
TERM = {"name": "noise", "less_mm3": 5.0, "more_mm3": 5.0, "why": "noise"}


def table(folder: Path, *, unreliable: set[str] = frozenset(), trusted: str = "yes") -> Path:
    """Write the lengths and volumes of six plants on two days; those of treatment b are half as long."""
    rows = []
    for k in range(6):
        plant, half = f"p{k}", 0.5 if k % 2 else 1.0
        for day in (5, 10):
            length = half * day * (100.0 + k)
            word = "not reliable" if plant in unreliable else "reliable"
            ends = f"{0.95 * length},{1.05 * length}"
            rows.append(f"r{k}_{day},{plant},{'ab'[k % 2]},{day},{length},{ends},{word},{length / 10},{trusted}\n")
    return written(folder, HEAD + "".join(rows))


def written(folder: Path, text: str) -> Path:
    (folder / "traits.csv").write_text(text, encoding="utf-8")
    return folder / "traits.csv"


def test_growth_compares_reliable_values_only(tmp_path: Path) -> None:
    found = growth.measure(read_all([table(tmp_path, unreliable={"p1"})]))
    assert {one.plant for one in found.seen["total_length"]} == {"p0", "p2", "p3", "p4", "p5"}
    assert any(note.startswith("total_length: 2 of 12 values are excluded") for note in found.notes)
    rows = [row.split(",") for row in growth.traits_csv(found).splitlines()]
    assert {(row[7], row[9] == "") for row in rows if row[0] == "p1" and row[3] == "total_length_mm"} == {("not reliable", True)}
    every = {f"p{k}" for k in range(6)}
    found = growth.measure(read_all([table(tmp_path, unreliable=every)]))
    assert "total_length" not in found.curves
    with pytest.raises(UserError, match=r"total_length: 12 of 12 .* volume: 12 of 12"):
        growth.measure(read_all([table(tmp_path, unreliable=every, trusted="no")]))


def test_leaves_are_counted_and_measured_over_time(tmp_path: Path) -> None:
    found = growth.measure(read_all([written(tmp_path, LEAVES)]))
    assert [(point.day, round(point.mean, 9)) for point in found.curves["leaves"] if point.treatment == "a"] == [(5.0, 2.0), (10.0, 3.0)]
    assert found.compared["leaf_area"][0].size == pytest.approx(0.5, abs=0.1)
    assert found.compared["ndvi"][0].size == pytest.approx(0.5, abs=0.1)
    assert "ndvi" in growth_page.page(found)


def test_rates_and_emergence_are_computed_from_reliable_days(ball_result: Callable[..., Path]) -> None:
    """A lateral grows by 5 mm per day from day 2 on; on day 5, when half of it is hidden, the length is not reliable."""
    folders = []
    for day, long_mm in ((1.0, 0.0), (3.0, 5.0), (5.0, 7.5), (7.0, 25.0)):
        length = {"name": "total_length_mm", "value": 90.0, "interval": [60.0, 120.0], "trusted": day != 5.0, "verdict": "hidden"}
        folder = ball_result(f"day_{day:g}", subject={"plant": "P", "day": day}, volume_budget=[TERM], estimates=[length])
        ends = [(0.0, 0.0, 0.0), (0.0, 0.0, -40.0)], [(0.0, 0.0, -30.0), (0.0, 9.0, -35.0)], [(0.0, 0.0, -20.0), (long_mm, 0.0, -20.0)]
        roots = [straight(*both, 1.0, count=40, order=order, parent=order - 1) for both, order in zip(ends, (0, 1, 1), strict=True)]
        rsml.write_rsml(folder / "roots.rsml", roots if long_mm else roots[:2])
        folders.append(folder)
    rows = list(csv.DictReader(growth.roots_csv(growth.measure(read_all(folders))).splitlines()))
    found = [(row["day"], row["emergence_day"], row["elongation_mm_per_day"], row["verdict"]) for row in rows if row["root"] == "1.2"]
    assert found == [("3", "2.00", "", "reliable"), ("5", "2.00", "", "not reliable"), ("7", "2.00", "5", "reliable")]


def test_biomass_fits_reliable_traits_and_keeps_the_verdict(tmp_path: Path) -> None:
    measured = read_all([table(tmp_path, trusted="no")])
    weighed = "".join(f"p{k},10,{0.05 * (100 + k) * (2 - k % 2)}\n" for k in range(6))
    (tmp_path / "masses.csv").write_text("plant,day,root_fresh_g\n" + weighed, encoding="utf-8")
    found, notes = biomass.pairs(measured, read_masses(tmp_path / "masses.csv", balance_g=1e-4))
    model = biomass.fit(found, balance_g=1e-4, notes=notes)
    assert {relation.trait for relation in model.tried} == {"total_length"}
    assert any(note.startswith("volume: 6 of 6") for note in model.notes)
    rows = model_file.to_csv(model_file.predict(model, read_all([table(tmp_path, unreliable={"p2"})]))).splitlines()
    column = rows[0].split(",").index("verdict")
    assert {row.split(",")[column] for row in rows[1:] if ",p2," in row} == {"not reliable"}
    assert {row.split(",")[column] for row in rows[1:] if ",p0," in row} == {"reliable"}


UNIT = r"line 2: the column .* has another unit than \w+; convert the values and rename the column"
BAD_TABLES = {
    "verdict": ("plant,day,tips,tips_verdict\nP,1,9,fine\n", "line 2: the verdict on tips is 'fine'; a verdict must be one of"),
    "exchanged ends": ("plant,day,tips,tips_low,tips_high\nP,1,9,12,8\n", "line 2: the interval of tips begins at 12, but ends"),
    "no days": ("plant,tips\n1,9\n", "is missing; enter it in the column 'day'"),
    "cm of an interval": ("plant,day,total_length_low (cm)\nP,1,50\n", UNIT),
    "two units": ("plant,day,volume_mm3 (ml)\nP,1,50\n", UNIT),
}


@pytest.mark.parametrize(("text", "named"), BAD_TABLES.values(), ids=BAD_TABLES.keys())
def test_a_wrong_table_is_refused(text: str, named: str, tmp_path: Path) -> None:
    with pytest.raises(UserError, match=named):
        growth.measure(read_all([written(tmp_path, text)]))


def test_intervals_follow_from_those_of_other_traits(ball_result: Callable[..., Path]) -> None:
    values = {"total_length_mm": (400.0, 360.0, 440.0), "tips": (10.0, 8.0, 12.0), "mean_diameter_mm": (0.5, 0.4, 0.6)}
    estimates = [
        {"name": name, "value": v, "interval": [low, high], "trusted": True, "verdict": ""} for name, (v, low, high) in values.items()
    ]
    forks = {"name": "forks", "state": "fair", "value": 0.05, "unit": "share", "fair": None, "bad": None, "found": "", "advice": ""}
    folder = ball_result("one", volume_budget=[TERM], estimates=estimates, hidden_height_mm=3.0, checks=[forks])
    measured = {name: v for name, (v, _, _) in values.items()} | {
        "tips": 10,
        "roots": 11,
        "branch_points": 8,
        "surface_mm2": 600.0,
        "depth_mm": 50.0,
    }
    found = assessments.assess(result_files.read_summary(folder), replace(stored_traits.read(folder), **measured))
    assert found["roots"].interval == pytest.approx((8, 14))
    assert found["branch_points"].interval == pytest.approx((6, 10))
    reach = (np.hypot(np.log(0.9), np.log(0.8)), np.hypot(np.log(1.1), np.log(1.2)))  # of length and mean diameter
    assert found["surface_mm2"].interval == pytest.approx((600.0 * np.exp(-reach[0]), 600.0 * np.exp(reach[1])))
    low, high = found["depth_mm"].interval
    assert (low, high) == pytest.approx((45.0, 58.0)), "a tenth, and 3 mm behind the net pot"
    traits = replace(stored_traits.read(folder), **measured, length_by_order_mm=(100.0, 290.0, 10.0))
    orders = next(one["bins"] for one in trait_table.to_json(traits, found)["histograms"] if one["name"] == "length_by_order_mm")
    ranges = [(one["low"], one["high"]) for one in orders]
    assert ranges == [pytest.approx(end) for end in ((70.0, 130.0), (241.0, 339.0), (0.0, 31.0))], "a tenth, and 20 mm whose order is open"
    assert {found[name].verdict for name in ("depth_mm", "surface_mm2", "roots")} == {"reliable"}


def test_results_carry_assessments(ball_result: Callable[..., Path]) -> None:
    reason = "the number of tips is not to be trusted: few"
    tips = {"name": "tips", "value": 9.0, "interval": [8.0, 12.0], "trusted": False, "verdict": reason}
    folder = ball_result("one", volume_budget=[TERM], estimates=[tips])
    summary, traits = result_files.read_summary(folder), stored_traits.read(folder)
    found = assessments.assess(summary, traits)
    assert (found["volume_mm3"].verdict, found["volume_mm3"].interval) == ("reliable", (850.0, 950.0))
    assert (found["tips"].verdict, found["tips"].reason) == ("not reliable", reason)
    assert (found["width_mm"].verdict, found["width_mm"].interval) == ("no interval", None)
    assert (found["branch_points"].verdict, found["branch_points"].reason) == ("not reliable", reason), "one for each lateral"
    text = stored_traits.spreadsheet([("one", summary, traits)]).splitlines()
    row = dict(zip(text[0].split(","), text[1].split(","), strict=True))
    assert (row["volume_mm3_low"], row["volume_mm3_verdict"], row["depth_mm_verdict"]) == ("850", "reliable", "no interval")
    assert [one.assessment("volume").interval for one in read_all([folder])] == [(850.0, 950.0)]
    folder = ball_result("refused", volume_budget=[TERM], volume_trusted=False, volume_verdict="this scan cannot give a volume: too dark")
    (one,) = read_all([folder])
    assert one.usable("volume") is one.usable("depth") is None
    why = "depth: 1 of 1 values are excluded, because they are not reliable: the scan is not reliable: too dark"
    assert exclusion_notes([one], ["depth"]) == [why]
