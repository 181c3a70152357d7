"""`rhizotwin traits` on results, one and many."""

import csv
import json
from collections.abc import Callable
from pathlib import Path

import pytest

from rhizotwin import cli


@pytest.fixture
def results(ball_result: Callable[..., Path]) -> list[str]:
    """Return two results without roots, each weighed 1 g."""
    return [str(ball_result(name, mass_g=1.0, warnings=["it is dark, alas"])) for name in ("one", "two")]


def test_one_result_is_printed_with_units(results: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["traits", results[0]]) == 0
    out = capsys.readouterr().out
    assert "volume 0.850 to 0.950 ml" in out
    assert [line.split()[:3] for line in out.splitlines() if line.startswith("  volume ")] == [["volume", "905", "mm3"]]
    assert "no roots were found" in out


def test_many_results_make_one_spreadsheet(results: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table = tmp_path / "table.csv"
    words = ["traits", *results, "--mass-g", "1.81,1.81", "-o", str(table)]
    assert cli.main(words) == 0, capsys.readouterr().err
    rows = list(csv.DictReader(table.read_text(encoding="utf-8").splitlines()))
    assert [row["result"] for row in rows] == ["one", "two"]
    assert [float(row["tissue_density (g/ml)"]) for row in rows] == pytest.approx([2.0, 2.0])
    assert rows[0]["warnings"] == "it is dark, alas"
    assert cli.main(words) == 2  # never over a file that is there


def test_json_has_every_number_and_the_mass_that_was_kept(results: list[str], tmp_path: Path) -> None:
    assert cli.main(["traits", results[0], "-o", str(tmp_path / "t.json")]) == 0
    (stored,) = json.loads((tmp_path / "t.json").read_text())
    assert (stored["result"], stored["mass_g"]) == ("one", 1.0)
    values = {trait["name"]: trait["value"] for trait in stored["traits"]}
    assert values["tissue_density"] == pytest.approx(1.0 / 0.905)
    assert values["total_length"] is None


MISTAKES = {
    "one mass for two": (["--mass-g", "1"], "1 masses for 2 results"),
    "no mass": (["--mass-g", "0,1"], "out of range"),
    "another form": (["-o", "table.xlsx"], ".csv or .json"),
}


@pytest.mark.parametrize(("words", "says"), MISTAKES.values(), ids=MISTAKES.keys())
def test_mistakes(results: list[str], capsys: pytest.CaptureFixture[str], words: list[str], says: str) -> None:
    assert cli.main(["traits", *results, *words]) == 2
    assert says in capsys.readouterr().err
