"""`rhizotwin traits` on results, one and many."""

import csv
import json
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.command import Command


@pytest.fixture
def results(ball_result: Callable[..., Path]) -> list[Path]:
    """Return two results without roots, each weighed 1 g."""
    budget = [{"name": "radii", "less_mm3": 50.0, "more_mm3": 50.0, "why": "the views disagree"}]
    return [ball_result(name, mass_g=1.0, volume_budget=budget, warnings=["it is dark, alas"]) for name in ("one", "two")]


def test_one_result_is_printed_with_units(results: list[Path], command: Command) -> None:
    out = command.works("traits", results[0]).out
    (volume,) = [line for line in out.splitlines() if line.startswith("  volume ")]
    assert volume.split()[:6] == ["volume", "905", "mm3", "850", "to", "950"]
    assert "no roots were found" in out


def test_many_results_make_one_spreadsheet(results: list[Path], tmp_path: Path, command: Command) -> None:
    table = tmp_path / "table.csv"
    words = ("traits", *results, "--mass-g", "1.81,1.81", "-o", table)
    command.works(*words)
    rows = list(csv.DictReader(table.read_text(encoding="utf-8").splitlines()))
    assert [row["result"] for row in rows] == ["one", "two"]
    assert [float(row["tissue_density_g_per_ml"]) for row in rows] == pytest.approx([2.0, 2.0])
    assert rows[0]["warnings"] == "it is dark, alas"
    command.fails(*words, named=["already exists"])


def test_results_of_one_folder_name_are_told_apart(ball_result: Callable[..., Path], tmp_path: Path, command: Command) -> None:
    folders = [ball_result(f"{day}/result") for day in ("day_1", "day_2")]
    command.works("traits", *folders, "-o", tmp_path / "t.csv")
    command.works("traits", *folders, "-o", tmp_path / "t.json")
    rows = list(csv.DictReader((tmp_path / "t.csv").read_text(encoding="utf-8").splitlines()))
    assert [row["result"] for row in rows] == ["day_1/result", "day_2/result"]
    assert [one["result"] for one in json.loads((tmp_path / "t.json").read_text())] == ["day_1/result", "day_2/result"]


def test_json_has_every_number_and_the_mass_that_was_kept(results: list[Path], tmp_path: Path, command: Command) -> None:
    command.works("traits", results[0], "-o", tmp_path / "t.json")
    (stored,) = json.loads((tmp_path / "t.json").read_text())
    assert (stored["result"], stored["mass_g"]) == ("one", 1.0)
    values = {trait["name"]: trait["value"] for trait in stored["traits"]}
    assert values["tissue_density_g_per_ml"] == pytest.approx(1.0 / 0.905)
    assert values["total_length_mm"] is None


def test_mistakes(results: list[Path], command: Command) -> None:
    command.fails("traits", *results, "--mass-g", "1", named=["1 values for 2 results"])
    command.fails("traits", *results, "--mass-g", "0,1", named=["out of range"])
    command.fails("traits", *results, "-o", "table.xlsx", named=[".csv or .json"])
