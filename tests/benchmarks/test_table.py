"""The ladder: numbers of its table and committed results, which must be traced to a commit, and the page beside the thesis."""

import json
import math
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks import cases, ladder, table, thesis_figures, thesis_page, tree_scatter
from benchmarks.cases import FAMILIES, Case, Pictures
from benchmarks.targets import TARGETS
from rhizotwin.recon.optics.refraction import Optics
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Scene


@pytest.fixture(scope="module")
def records(record_of):
    """Return runs of the whole ladder: ours get worse with the profile, the thesis's volume is ten times the truth."""

    def one(case):
        error = {"clean": -0.02, "bench": 0.04, "harsh": 0.30}[case.pictures.profile] * (2.0 if case.pictures.scene.endswith("c") else 1.0)
        tips = 0.97 if case.pictures.scene.startswith("radish_day") else 0.77
        holds = case.pictures.profile != "harsh"
        return record_of(case, volume_error=9.0 if case.method == "thesis" else error, tips=tips, holds=holds)

    return [one(case) for case in cases.ladder(scenes=("printed_8ml", "radish_*", "fallen_plant", *FAMILIES))]


def by_key(records):
    return {line.key: line for line in table.lines(records)}


def test_numbers_of_groups(records):
    found = by_key(records)
    assert {key for key in TARGETS if key.startswith("ladder/")} <= found.keys()
    early = found["ladder/radish_day05-15/clean/volume_median"]
    assert (early.runs, early.value, early.verdict, early.thesis) == (3, pytest.approx(0.02), "yes", pytest.approx(9.0))
    assert found["ladder/radish_day05-15_one_ring/clean/volume_worst"].value == pytest.approx(0.04)
    assert found["ladder/radish_day20-30/harsh/volume_worst"].verdict == ""  # no goal but the interval
    assert found["ladder/radish_day20-30/harsh/interval_holds"].verdict == "NO"
    assert found["ladder/plants_one_ring/clean/tip_recall"].value == pytest.approx((18 * 0.97 + 0.77) / 19)
    assert found["ladder/plants/clean/tip_recall_worst"].value == pytest.approx(0.77)  # beside every mean stands the worst
    assert found["ladder/plants/clean/length_mean"].thesis is None
    assert found["ladder/thin_families/clean/volume_worst"].runs == 4 + 2  # one of them at two sizes more
    assert found["ladder/thin_families_one_ring/clean/volume_worst"].runs == 4
    assert found["ladder/plants_one_ring/bench/identity"].value == pytest.approx(0.95)
    assert found["ladder/thick_families/bench/volume_worst"].verdict == "yes"
    assert found["ladder/all/bench/interval_holds"].value == 1.0
    assert "ladder/fallen_plant/harsh/volume_worst" not in found
    part = [r for r in records if (r["case"]["scene"], r["case"]["method"], r["case"]["rings"]) == ("radish_day05b", "coverage", 2)]
    assert {line.group for line in table.lines(part)} == {"radish_day05-15", "plants", "all"}
    assert all(line.runs == 1 and line.thesis is None for line in table.lines(part))


def test_a_run_without_a_number_cannot_reach_the_goal(records):
    records = deepcopy(records)
    broken = next(r for r in records if (r["case"]["scene"], r["case"]["method"], r["case"]["rings"]) == ("radish_day10b", "coverage", 2))
    broken["score"]["volume_error"] = None
    broken["score"]["roots"] = None
    found = by_key(records)
    assert math.isnan(found["ladder/radish_day05-15/clean/volume_median"].value)
    assert found["ladder/radish_day05-15/clean/volume_worst"].verdict == "NO"
    assert found["ladder/plants/clean/length_mean"].verdict == "NO"
    assert "| none |" in table.markdown(table.lines(records), records)


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


def record(scene: str, method: str, rings: int, mm3: float) -> dict[str, Any]:
    case = {"name": f"{scene}/clean/{'2x' * (rings == 2)}40x800x600/0.27/{method}", "scene": scene, "method": method, "rings": rings}
    interval = [0.9 * mm3, 1.1 * mm3] if method == "coverage" else None
    return {"case": case, "commit": "0123abcd", "score": {"volume_mm3": mm3, "volume_interval_mm3": interval}}


def test_plants_of_thesis_are_those_of_the_library() -> None:
    first, last = record("radish_day05a", "thesis", 2, 600.0), record("radish_day30c", "coverage", 1, 1750.0)
    found = thesis_page.plants([first, last])
    assert len(found) == 18
    assert (found[0].name, found[0].thesis_ml, found[0].grams) == ("radish 1", 1.79, 0.0348)
    assert found[0].runs == {("thesis", 2): first}
    assert found[16].thesis_ml is None
    assert found[17].runs == {("coverage", 1): last}
    grams = {one.name: one.grams for one in found}
    scenes = [case.pictures.scene_to_render() for case in thesis_page.plant_cases("clean")]
    # the twin's plant has the thesis's mass at 1 g/ml
    assert {scene.subject.plant: scene.specimen.volume_ml for scene in scenes} == pytest.approx(grams)


def test_only_the_ladder_s_own_radishes_are_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "ladder.json"
    monkeypatch.setattr(ladder, "PATH", path)
    assert thesis_page.committed_records("clean") == []
    wanted = [record("radish_day05b", "coverage", rings, 35.0) for rings in (1, 2)]
    other = [record("wheat", "coverage", 2, 35.0), record("radish_day05b/seed101", "coverage", 2, 35.0)]
    path.write_text(json.dumps({"schema_version": 1, "records": [*wanted, *other]}), encoding="utf-8")
    assert thesis_page.committed_records("clean") == wanted
    assert thesis_page.committed_records("bench") == []


def test_circle_is_found_through_noise_and_ray_keeps_to_snell() -> None:
    rng = np.random.default_rng(0)
    turn = rng.uniform(0.0, 2.0 * np.pi, 40)
    points = np.stack([3.0 + 400.0 * np.cos(turn), -2.0 + 400.0 * np.sin(turn)], axis=1) + rng.normal(0.0, 0.2, (40, 2))
    middle, radius, away = thesis_figures.fit_circle(points)
    assert (*middle, radius) == pytest.approx((3.0, -2.0, 400.0), abs=0.2)
    assert away.std() == pytest.approx(0.2, rel=0.3)
    optics = Optics.from_scene(Scene())
    for w in (-0.7, -0.2, 0.4, 0.9):
        camera, outer, entry, leave = thesis_figures.ray_path(optics, 400.0, w)
        radii = [optics.outer_radius_mm, optics.inner_radius_mm, optics.inner_radius_mm]
        assert [np.hypot(*at) for at in (outer, entry, leave)] == pytest.approx(radii)
        steps = [step / np.linalg.norm(step) for step in (outer - camera, entry - outer, leave - entry)]
        for k, (at, indices) in enumerate(((outer, (1.0, optics.n_wall)), (entry, (optics.n_wall, optics.n_water)))):
            normal = at / np.linalg.norm(at)
            across = [n * (step[0] * normal[1] - step[1] * normal[0]) for n, step in zip(indices, steps[k : k + 2], strict=True)]
            assert across[0] == pytest.approx(across[1], abs=1e-9)  # n sin(angle) is the same on both sides
