"""Traits of shoots in tables, and masses of shoots by their leaf area."""

import csv
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from rhizotwin.experiment import biomass
from rhizotwin.experiment.masses import read_masses
from rhizotwin.experiment.measured import read_all
from rhizotwin.stored import stored_traits
from tests.command import Command

GRAMS_PER_CM2 = 0.045


def shoot(leaf_area_mm2: float, wobble: float) -> dict[str, object]:
    areas = {"surface_area_mm2": 1.2 * leaf_area_mm2, "projected_mean_mm2": 0.5 * leaf_area_mm2 * wobble}
    volumes = {"volume_mm3": None, "convex_mm3": 1000.0, "hull_mm3": 900.0}
    return {"leaf_area_mm2": leaf_area_mm2, "leaves": 6, "height_mm": 40.0, "pot_top_mm": 31.0, "hidden_share": 0.0} | areas | volumes


@pytest.fixture
def results(ball_result: Callable[..., Path], tmp_path: Path) -> Path:
    rng = np.random.default_rng(4)
    rows = ["plant,shoot_fresh_g"]
    for number, area in enumerate(np.geomspace(200.0, 4000.0, 8)):
        who = {"plant": f"P{number}", "species": "Raphanus sativus", "day": 10.0}
        ball_result(f"results/P{number}", subject=who, shoot=shoot(float(area), float(np.exp(rng.normal(0.0, 0.3)))))
        rows.append(f"P{number},{GRAMS_PER_CM2 * area / 100.0 * np.exp(rng.normal(0.0, 0.02)):.5f}")
    (tmp_path / "masses.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    return tmp_path / "results"


def test_tables_have_columns_of_shoots(results: Path, ball_result, tmp_path: Path, command: Command) -> None:
    table = tmp_path / "traits.csv"
    command.works("traits", *sorted(results.iterdir()), "-o", table)
    rows = list(csv.DictReader(table.read_text(encoding="utf-8").splitlines()))
    assert (rows[0]["leaf_area_mm2"], rows[0]["leaves"], rows[0]["shoot_volume_mm3"]) == ("200", "6", "")
    again = {one.subject.plant: one.traits for one in read_all([table])}
    assert again["P7"]["leaf_area"] == pytest.approx(4000.0)
    assert "shoot_volume" not in again["P7"]
    command.works("traits", ball_result("alone"), "-o", tmp_path / "without.csv")
    assert "leaf_area" not in (tmp_path / "without.csv").read_text(encoding="utf-8")


@pytest.mark.parametrize(("names", "known"), [((), True), (("A",), True), (("A", "B"), False)])
def test_a_shoot_is_that_of_the_only_plant(names: tuple[str, ...], known: bool) -> None:
    summary = {"plants": [{"plant": name} for name in names], "shoot": shoot(200.0, 1.0)}
    assert stored_traits.of_shoot(summary) == (summary["shoot"] if known else None)


def test_a_shoots_mass_is_told_by_its_leaf_area(results: Path, tmp_path: Path) -> None:
    found, _ = biomass.pairs(read_all([results]), read_masses(tmp_path / "masses.csv", balance_g=1e-4))
    (best,) = biomass.fit(found, balance_g=1e-4).relations
    assert (best.kind, best.trait, best.proportional) == ("shoot_fresh", "leaf_area", True)
    grams, low, high = best.predict(1000.0, 0.0)
    assert grams == pytest.approx(GRAMS_PER_CM2 * 10.0, rel=0.03)
    assert low < grams < high
