"""Dose response: known slopes inside their intervals, ions that vary together, curvature, and the command."""

import csv
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import linregress
from scipy.stats import t as student

from rhizotwin.experiment import growth
from rhizotwin.experiment.compare import Observation
from rhizotwin.experiment.doses import fit_responses, group_ions, partial_residuals, reason_not_fitted
from rhizotwin.experiment.measured import read_all
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.solution import Solution, headings
from tests.command import Command

pytest.importorskip("statsmodels")
DAYS = (5.0, 10.0, 15.0)
SLOPE = 0.05
PLANT_SD, ERROR = 0.08, 0.03
"""Of the logarithm: how much plants differ, and the error of a scan."""

Doses = dict[str, Mapping[str, float]]


def experiment(seed: int, factors: tuple[dict[str, float], ...], *, plants: int = 24, bend: float = 0.0) -> tuple[list[Observation], Doses]:
    """Return lengths of plants in solutions of some factors; they follow potassium."""
    rng, seen, doses = np.random.default_rng(seed), [], {}
    for k in range(plants):
        own = doses[f"p{k}"] = Solution(recipe="kliman_2022", factors=factors[k % len(factors)]).ions_mmol_per_l
        level = SLOPE * own["K"] + bend * (own["K"] - 5.0) ** 2 + rng.normal(0.0, PLANT_SD)
        sizes = {day: float(np.exp(0.1 * day + level + rng.normal(0.0, ERROR))) for day in DAYS}
        seen += [Observation(plant=f"p{k}", treatment="", day=day, value=size) for day, size in sizes.items()]
    return seen, doses


POTASSIUM = tuple({"K": factor} for factor in (0.25, 0.5, 1.0, 2.0))


def test_of_complete_data_the_slope_is_a_regression_of_means() -> None:
    seen, doses = experiment(0, POTASSIUM)
    (found,) = fit_responses(seen, doses)
    assert (found.ion, found.with_ions, found.levels, found.plants) == ("K", ("H2PO4", "NO3"), 4, 24)
    means = [np.mean([np.log(one.value) for one in seen if one.plant == plant]) for plant in doses]
    line = linregress([own["K"] for own in doses.values()], means)
    reach = student.ppf(0.95, 22) * line.stderr
    assert (found.slope, found.slope_p) == pytest.approx((line.slope, line.pvalue), rel=0.02)
    assert found.slope_interval == pytest.approx((line.slope - reach, line.slope + reach), rel=0.02)
    assert (found.curvature_p or 0.0) > 0.05
    (bent,) = fit_responses(*experiment(1, POTASSIUM, bend=-0.02))
    assert (bent.curvature_p or 1.0) < 0.01
    assert "not linear" in bent.sentence("total_length")


def test_ions_of_a_factorial_are_separated_by_factor() -> None:
    factorial = tuple({"KH2PO4": p, "MgSO4.7H2O": m, "KNO3": k} for p in (1.0,) for m in (0.5, 1.0, 2.0) for k in (0.5, 1.0, 2.0))
    seen, doses = experiment(2, factorial, plants=27)
    assert {frozenset(group) for group in group_ions(doses)} == {frozenset({"Mg", "SO4"}), frozenset({"K", "NO3"})}
    found = {one.ion: one for one in fit_responses(seen, doses)}
    magnesium = next(one for ion, one in found.items() if ion in ("Mg", "SO4"))
    assert magnesium.slope_p > 0.05
    potassium = found["K"]
    assert potassium.slope == pytest.approx(SLOPE, abs=3.0 * (potassium.slope_interval[1] - potassium.slope))
    points = partial_residuals(seen, doses, list(found.values()))
    line = np.polyfit(points[0, :, 0], np.log(points[0, :, 1]), 1)
    assert line[0] == pytest.approx(next(iter(found.values())).slope, abs=1e-3)


def test_what_cannot_be_fitted_is_not() -> None:
    seen, doses = experiment(3, POTASSIUM)
    assert fit_responses(seen, dict.fromkeys(doses, doses["p0"])) == []
    assert fit_responses([one for one in seen if one.plant in ("p0", "p1")], doses) == []
    seen, doses = experiment(3, POTASSIUM[:2])
    (two,) = fit_responses(seen, doses)
    assert two.curvature_p is None
    assert reason_not_fitted(seen, doses) == ""
    apart = [one for one in seen if (doses[one.plant] == doses["p0"]) == (one.day == DAYS[0])]
    why = "plants with different concentrations share too few days; scan all treatments on the same days"
    assert reason_not_fitted(apart, doses) == why
    assert fit_responses(apart, doses) == []


def table(folder: Path, *, change: bool = False) -> Path:
    """Write plants in four solutions as `rhizotwin traits` does; one is in another solution on its last day."""
    seen, doses = experiment(4, POTASSIUM)
    heads = headings(list(doses.values()))
    rows = [["plant", "day", "total_length (mm)", "total_length_verdict", *heads.values()]]
    for one in seen:
        own = doses["p1" if change and (one.plant, one.day) == ("p0", DAYS[-1]) else one.plant]
        rows.append([one.plant, f"{one.day:g}", f"{one.value:.6g}", "reliable", *(f"{own[ion]:.7g}" for ion in heads)])
    return written(folder, "\n".join(",".join(row) for row in rows))


def written(folder: Path, text: str) -> Path:
    (folder / "traits.csv").write_text(text, encoding="utf-8")
    return folder / "traits.csv"


def test_the_command_reads_columns_and_writes_doses(tmp_path: Path, command: Command) -> None:
    out = tmp_path / "growth"
    told = command.works("growth", table(tmp_path), "-o", out).out
    assert "from 1.34 to 10.7 mmol/l K (together with H2PO4, NO3) on the mean day" in told
    (row,) = csv.DictReader((out / "doses.csv").read_text(encoding="utf-8").splitlines())
    assert (row["trait"], row["ion"], row["together_with"], row["levels"]) == ("total_length_mm", "K", "H2PO4 NO3", "4")
    assert float(row["low"]) < SLOPE < float(row["high"])
    assert (out / "doses.png").read_bytes()[:4] == b"\x89PNG"
    assert "K (mmol/l)" in (out / "traits.csv").read_text(encoding="utf-8").splitlines()[0]
    two = "plant,day,total_length (mm),K (mmol/l)\np1,5,10,1\np2,5,20,2\n"
    why = "plants with different concentrations have 2 scans, too few to estimate an uncertainty; scan more plants on each day"
    notes = growth.measure(read_all([written(tmp_path, two)])).notes
    assert f"total_length: the dose response could not be fitted, because {why}" in notes
    with pytest.raises(UserError, match=r"plant p0 has two nutrient solutions\. .* differ in"):
        growth.measure(read_all([table(tmp_path, change=True)]))
