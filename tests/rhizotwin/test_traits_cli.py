"""`rhizotwin traits` on results, one and many."""

import csv
import json
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.command import Command


@pytest.fixture
def results(ball_result: Callable[..., Path]) -> list[Path]:
    """Return two results without roots in folders of one name, each weighed 1 g."""
    budget = [{"name": "radii", "less_mm3": 50.0, "more_mm3": 50.0, "why": "the views disagree"}]
    return [ball_result(name, mass_g=1.0, volume_budget=budget, warnings=["it is dark, alas"]) for name in ("one/result", "two/result")]


def test_many_results_make_one_spreadsheet(results: list[Path], tmp_path: Path, command: Command) -> None:
    table = tmp_path / "table.csv"
    words = ("traits", *results, "--mass-g", "1.81,1.81", "-o", table)
    command.works(*words)
    rows = list(csv.DictReader(table.read_text(encoding="utf-8").splitlines()))
    assert [row["result"] for row in rows] == ["one/result", "two/result"]
    assert [float(row["tissue_density_g_per_ml"]) for row in rows] == pytest.approx([2.0, 2.0])
    assert rows[0]["warnings"] == "it is dark, alas"
    command.fails(*words, named=["already exists"])
    command.fails("traits", *results, "--mass-g", "1", named=["1 values for 2 results"])
    command.fails("traits", *results, "--mass-g", "0,1", named=["out of range"])
    command.fails("traits", *results, "-o", "table.xlsx", named=[".csv or .json"])


def test_json_has_every_number_and_the_mass_that_was_kept(results: list[Path], tmp_path: Path, command: Command) -> None:
    command.works("traits", *results, "-o", tmp_path / "t.json")
    stored, other = json.loads((tmp_path / "t.json").read_text())
    assert (stored["result"], stored["mass_g"], other["result"]) == ("one/result", 1.0, "two/result")
    values = {trait["name"]: trait["value"] for trait in stored["traits"]}
    assert values["tissue_density_g_per_ml"] == pytest.approx(1.0 / 0.905)
    assert values["total_length_mm"] is None
