"""Corrected results: volume, traits and their reliability, shoot, and the record of corrections."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from rhizotwin.corrections import against_pictures, corrected, log
from rhizotwin.corrections.session import Session
from rhizotwin.recon.results import assessments, by_plant, divide_by_plant, result_traits
from rhizotwin.recon.roots import plants as recon_plants
from rhizotwin.recon.shoots.shoot import Shoot
from rhizotwin.recon.uncertainty.checks import Estimate
from rhizotwin.scenes.plants import Plant as ScenePlant
from rhizotwin.scenes.rsml_reader import read_rsml
from rhizotwin.scenes.subject import Subject
from rhizotwin.stored import result_files, save, stored_traits
from rhizotwin.stored.load import load_result
from tests.rhizotwin import plant as plants
from tests.rhizotwin.plant import Plant


def volume_of(folder: Path) -> float:
    leaves = result_files.read_leaves(folder)
    return float((leaves.occupancy.astype(np.float64) * (leaves.size * leaves.voxel_mm) ** 3).sum())


def test_nothing_done_changes_nothing_and_needs_no_settings(own: Path):
    summary = json.loads((own / "result.json").read_text())
    session = Session(own)
    assert session.measure().volume_mm3 == pytest.approx(volume_of(own), rel=1e-6)
    assert session.measure().length_mm == pytest.approx(load_result(own).solid.length_mm)
    del summary["settings"]
    (own / "result.json").write_text(json.dumps(summary))
    session = Session(own)
    session.do(log.edit("delete roots", roots=[1]))
    assert session.measure().roots == 3


def test_a_log_makes_the_same_result_again(own: Path, tmp_path: Path):
    files = {path: path.read_bytes() for path in own.rglob("*") if path.is_file() and path.name != log.LOG_NAME}
    session = Session(own)
    session.do(log.edit("delete roots", roots=[1], who="ann"))
    session.do(log.edit("cut", roots=[0], point_mm=(1.0, 0.5, -40.0), who="ben"))
    saved = session.save()
    assert {path: path.read_bytes() for path in files} == files
    made = log.read(saved, own)
    saved.unlink()
    again = Session(own, log=made)
    summary = corrected.write(again, tmp_path / "new")
    assert summary["volume_mm3"] == pytest.approx(session.measure().volume_mm3, rel=1e-9)
    assert volume_of(tmp_path / "new") == pytest.approx(summary["volume_mm3"], rel=1e-5)
    loaded = load_result(tmp_path / "new")
    assert loaded.summary()["edits"] == summary["edits"]
    assert loaded.solid.length_mm == pytest.approx(session.measure().length_mm)
    assert loaded.measured.total_length_mm == pytest.approx(session.measure().length_mm)
    assert loaded.measured.volume_mm3 == summary["volume_mm3"]
    fresh = Session(tmp_path / "new").measure()
    assert fresh.volume_mm3 == pytest.approx(session.measure().volume_mm3, rel=1e-3)
    before, after = (result_files.read_mesh(folder / "shape.ply").vertices_mm for folder in (own, tmp_path / "new"))
    assert after[:, 0].max() < 5.0 < before[:, 0].max()  # root 1 went that way
    assert summary["edits"]["who"] == ["ann", "ben"]
    told = result_traits.describe_edits(summary)
    assert told.startswith("2 edits by ann, ben, -")
    assert told in stored_traits.spreadsheet([("a", summary, stored_traits.read(tmp_path / "new"))])
    assert json.loads((tmp_path / "new" / "traits.json").read_text())["edits"] == told


def test_a_trait_that_was_not_reliable_stays_so(own: Path, tmp_path: Path):
    one, length = load_result(own), load_result(own).solid.length_mm
    interval = (0.9 * length, 2.0 * length)
    estimate = Estimate(name="total_length_mm", value=length, interval=interval, trusted=False, verdict="the roots are too thin")
    replace(one, estimates=(estimate, replace(estimate, name="mean_diameter_mm", trusted=True))).save(own)
    session = Session(own)
    session.do(log.edit("delete roots", roots=[1, 2]))
    summary = corrected.write(session, tmp_path / "new")
    now = session.measure().length_mm
    (left,) = load_result(tmp_path / "new").estimates
    assert (left.name, left.value, left.interval) == ("total_length_mm", pytest.approx(now), pytest.approx((now, 2.0 * length)))
    judged = assessments.assess(summary, stored_traits.read(tmp_path / "new"))
    assert (judged["total_length_mm"].verdict, judged["mean_diameter_mm"].verdict) == ("not reliable", "no interval")
    assert judged["total_length_mm"].reason == "the roots are too thin"


def test_the_shoot_is_kept_and_its_result_can_be_replaced(own: Path, tmp_path: Path):
    mesh = trimesh.creation.icosphere(radius=5.0)
    shares = {"hidden_share": 0.1, "enclosed_share": 0.0, "stalks_mm3": 1.0, "leaf_thickness_mm": 0.3, "pot_top_mm": 8.0}
    blades = {"leaf_area_mm2": 80.0, "blades_mm2": (80.0,), "covered_px": {"a": 9.0}, "mm2_per_px": {"a": 1.0}}
    shoot = Shoot(mesh=mesh, hull_mm3=500.0, **shares, **blades)
    replace(load_result(own), shoot=shoot).save(own)
    session = Session(own)
    session.do(log.edit("delete roots", roots=[1]))
    for _ in range(2):
        corrected.write(session, tmp_path / "new")
        save.check_place(tmp_path / "new", own)
    kept = load_result(tmp_path / "new").shoot
    assert kept is not None
    assert kept.mesh.volume == pytest.approx(mesh.volume, rel=1e-5)


@pytest.mark.parametrize("roots", [(1, 1), (0, 0)], ids=["laterals", "main root and a lateral"])
def test_all_corrections_are_one_cause_and_one_check(plant: Plant, tmp_path: Path, roots: tuple[int, int]):
    """Root 0 is so large that its deletion contradicts the pictures; what was root 2 or 1 is then root 1 or 0."""
    source, found, first_mm3 = plant.result, against_pictures.Comparison(0.0, 0.0), Session(plant.result).summary["volume_mm3"]
    for root, name in zip(roots, ("once", "twice"), strict=True):
        session = Session(source)
        session.do(log.edit("delete roots", roots=[root], who=name))
        found += against_pictures.compare(session, None)
        source, summary = tmp_path / name, corrected.write(session, tmp_path / name)
        assert found.missed > 0.01
        assert against_pictures.recorded(summary).missed == pytest.approx(found.missed)
        assert against_pictures.recorded(summary).surplus == pytest.approx(found.surplus)
        (term,) = [one for one in summary["volume_budget"] if one["name"] == "corrections"]
        assert term["more_mm3"] == pytest.approx(found.missed * first_mm3)
        (check,) = [one for one in summary["checks"] if one["name"] == "corrections"]
        assert check["value"] == pytest.approx(found.check().value)
        assert summary["volume_verdict"].count("because of the corrections") == (found.check().state == "bad")
    assert found.check().state == ("fair" if roots == (1, 1) else "bad")
    again = corrected.write(Session(source), tmp_path / "again")
    assert again["checks"] == summary["checks"], "written again, it keeps its reliability"
    assert len(again["volume_budget"]) == len(summary["volume_budget"])
    assert (summary["edits"]["count"], summary["edits"]["who"]) == (2, ["once", "twice"])
    assert [one.edits[0].who for one in log.read_applied(tmp_path / "twice")] == ["once", "twice"]
    assert summary["edits"]["volume_before_mm3"] == pytest.approx(first_mm3)


@pytest.fixture(scope="module")
def pair(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a result of two plants: the plant on paper, and a straight root 14 mm beside it."""
    folder = tmp_path_factory.mktemp("pair")
    one = load_result(plants.make(folder, fibre=True).result)
    roots = tuple(replace(root, plant="B" if k == 4 else "A") for k, root in enumerate(one.solid.roots))
    known = [ScenePlant(plant="A"), ScenePlant(plant="B", at_mm=(-14.0, -10.0), treatment="low N")]
    planted = recon_plants.check_assignment(roots, known, grid_z_mm=-15.0)
    whole = {"leaves": one.solid.voxels, "surface": one.solid.surface, "finest_mm": one.solid.finest_mm}
    shape = divide_by_plant.Shape(volume_mm3=one.solid.volume.mm3, terms=one.solid.volume.terms, **whole)
    found = divide_by_plant.measure(shape, planted, known, Subject(species="Raphanus sativus"))
    (folder / "pair").mkdir()
    solid = replace(one.solid, roots=planted.roots)
    replace(one, solid=solid, plants=found, subject=Subject(species="Raphanus sativus")).save(folder / "pair")
    return folder / "pair"


def own_of(folder: Path) -> dict[str, tuple[float, float, str]]:
    """Return volume, length and treatment of each plant."""
    summary = result_files.read_summary(folder)
    found = by_plant.from_summary(summary, "result.json")
    assert sum(one.volume_mm3 for one in found) == pytest.approx(summary["volume_mm3"])
    return {one.subject.plant: (one.volume_mm3, float(one.traits.total_length_mm or 0.0), one.subject.treatment) for one in found}


def test_plants_that_share_a_canister_keep_their_own_numbers(pair: Path, tmp_path: Path):
    session = Session(pair)
    corrected.write(session, tmp_path / "same")
    before, same = own_of(pair), own_of(tmp_path / "same")
    assert {name: values[2] for name, values in same.items()} == {"A": "", "B": "low N"}
    for name, values in before.items():
        assert same[name][:2] == pytest.approx(values[:2], rel=1e-6)
    lateral = next(k for k, line in session.state.lines.items() if line.plant == "A" and line.parent >= 0)
    other = next(k for k, line in session.state.lines.items() if line.plant == "B")
    length = session.state.lines[lateral].length_mm
    session.do(log.edit("parent", roots=[lateral, other]))
    corrected.write(session, tmp_path / "moved")
    after = own_of(tmp_path / "moved")
    assert after["B"][1] - before["B"][1] == pytest.approx(length, rel=1e-6)
    assert before["A"][1] - after["A"][1] == pytest.approx(length, rel=1e-6)
    assert after["B"][0] > before["B"][0] + 1.0
    assert {root.plant for root in read_rsml(tmp_path / "moved" / "roots.rsml")} == {"A", "B"}
    session.do(log.edit("cut", roots=[lateral], point_mm=tuple(session.state.lines[lateral].points_mm[20])))
    assert [line.plant for line in session.state.lines.values()].count("B") == 3  # what is cut off stays the plant's


def test_a_plant_without_roots_is_one_no_more(pair: Path, tmp_path: Path):
    session = Session(pair)
    other = next(k for k, line in session.state.lines.items() if line.plant == "B")
    session.do(log.edit("delete roots", roots=[other]))
    corrected.write(session, tmp_path / "one")
    assert set(own_of(tmp_path / "one")) == {"A"}
    text = (tmp_path / "one" / "traits.csv").read_text(encoding="utf-8")
    assert {line.split(",")[0] for line in text.splitlines()[1:]} == {"", "A"}
