"""Results of one folder name have names of their own."""

from pathlib import Path

import pytest

from rhizotwin.stored import result_names


def test_results_of_one_name_are_told_apart_by_the_folders_above(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    given = ["day_1/result", "x/day_2/result", "y/day_2/result", "other", "."]
    assert result_names.names_of([Path(one) for one in given]) == [
        *("day_1/result", "x/day_2/result", "y/day_2/result", "other"),
        tmp_path.name,
    ]
    assert result_names.names_of([Path("a/result"), Path("a/result")]) == ["result", "result"]
    (tmp_path / "day_3").symlink_to(tmp_path)
    assert result_names.names_of([Path("day_3")]) == ["day_3"]
