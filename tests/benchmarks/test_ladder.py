"""The committed results of the ladder: parts renew their cases, and what cannot be traced to a commit is refused."""

import json

import pytest

from benchmarks import ladder, table, tree_scatter
from benchmarks.cases import Case, Pictures
from rhizotwin.scenes.errors import UserError

PLANT, BALL = (Case(pictures=Pictures(scene=name)) for name in ("radish_day05a", "sphere_20mm"))


def test_a_part_renews_its_cases_and_leaves_the_others(record_of, tmp_path):
    path = tmp_path / "ladder.json"
    assert ladder.read(path) == []
    ladder.update([record_of(PLANT), record_of(BALL)], path=path)
    newer = record_of(PLANT, volume_error=0.123456789) | {"commit": "89abcdef"}
    newer["score"]["traits"] = {"depth": 1.0}
    assert ladder.update([newer], path=path) == ladder.read(path)
    found = {record["case"]["scene"]: record for record in ladder.read(path)}
    assert (found["sphere_20mm"]["commit"], found["radish_day05a"]["commit"]) == ("0123abcd", "89abcdef")
    assert found["radish_day05a"]["score"]["volume_error"] == 0.123457
    assert "traits" not in found["radish_day05a"]["score"]
    page = table.page(ladder.read(path), {})
    assert "0123abcd, 89abcdef" in page
    assert [line.rpartition("| ")[2] for line in page.splitlines() if line.startswith("| `")] == ["89abcdef |", "0123abcd |"]


@pytest.mark.parametrize("commit", ["", "0123abcd+"])
def test_a_modified_reconstruction_is_not_recorded(record_of, tmp_path, commit):
    with pytest.raises(UserError, match="commit `recon` first"):
        ladder.update([record_of(PLANT) | {"commit": commit}], path=tmp_path / "ladder.json")
    assert not (tmp_path / "ladder.json").exists()


@pytest.mark.parametrize("content", ["{", "[]", '{"schema_version": 9, "records": []}', '{"schema_version": 1, "records": [{}]}'])
def test_a_damaged_file_is_named(tmp_path, content):
    (tmp_path / "ladder.json").write_text(content)
    with pytest.raises(UserError, match=r"ladder\.json"):
        ladder.read(tmp_path / "ladder.json")


def test_the_committed_ladder_and_its_page_agree():
    records = ladder.read()
    assert len(records) > 15
    page = (ladder.PATH.parent.parent / "docs" / "ladder.md").read_text(encoding="utf-8")
    assert page == table.page(records, tree_scatter.read())
    assert json.loads(ladder.PATH.read_text(encoding="utf-8"))["records"] == records
