"""Corrections: what they make of roots, voxels, volume and traits, and that a log makes them again."""

import json
import shutil
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import trimesh

from rhizotwin import command_steps
from rhizotwin.corrections import corrected, lines, log, surface
from rhizotwin.corrections.session import Session
from rhizotwin.recon.results import assessments, by_plant, divide_by_plant, result_traits
from rhizotwin.recon.roots import plants as recon_plants
from rhizotwin.recon.shoots.shoot import Shoot
from rhizotwin.recon.uncertainty.checks import Estimate
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.plants import Plant as ScenePlant
from rhizotwin.scenes.rsml_reader import read_rsml
from rhizotwin.scenes.subject import Subject
from rhizotwin.stored import result_files, stored_traits
from rhizotwin.stored.load import load_result
from tests.rhizotwin import plant as plants
from tests.rhizotwin.plant import Plant


@pytest.fixture(scope="module")
def plant(tmp_path_factory: pytest.TempPathFactory) -> Plant:
    """Return a plant that the tests share: they write logs beside it at most."""
    return plants.make(tmp_path_factory.mktemp("plant"))


@pytest.fixture
def own(plant: Plant, tmp_path: Path) -> Path:
    """Return a copy of the result, in which a test may save corrections."""
    return Path(shutil.copytree(plant.result, tmp_path / "own"))


def volume_of(folder: Path) -> float:
    leaves = result_files.read_leaves(folder)
    return float((leaves.occupancy.astype(np.float64) * (leaves.size * leaves.voxel_mm) ** 3).sum())


def painted_mm3(*roots) -> float:
    leaves = plants.painted(tuple(replace(root, parent=-1) for root in roots))
    return float(leaves.occupancy.sum(dtype=np.float64)) * leaves.voxel_mm**3


def test_nothing_done_changes_nothing(plant: Plant):
    session = Session(plant.result)
    assert session.measure().volume_mm3 == pytest.approx(volume_of(plant.result), rel=1e-6)
    assert session.measure().length_mm == pytest.approx(load_result(plant.result).solid.length_mm)


@pytest.mark.parametrize("gone", [(1,), (2, 3)])
def test_volume_without_roots_is_that_of_the_others_painted_afresh(plant: Plant, gone: tuple[int, ...]):
    """Painting a plant evens what sampling puts too much into full voxels out among the others, laterals by some 2 % of their own."""
    session = Session(plant.result)
    session.do(log.edit("delete roots", roots=gone))
    left = painted_mm3(*(root for k, root in enumerate(plant.roots) if k not in gone))
    assert session.measure().volume_mm3 == pytest.approx(left, rel=2.5e-3)


def test_the_volume_that_two_roots_share_stays_with_the_one_that_is_left(plant: Plant):
    """The laterals begin inside the main root, whose volume it is: without the main root it is theirs."""
    session = Session(plant.result)
    session.do(log.edit("delete roots", roots=[0]))
    assert session.measure().volume_mm3 == pytest.approx(painted_mm3(*plant.roots[1:]), rel=3e-2)
    assert {line.parent for line in session.state.lines.values()} == {-1}


def test_a_result_without_settings_can_be_corrected(own: Path):
    summary = json.loads((own / "result.json").read_text())
    del summary["settings"]
    (own / "result.json").write_text(json.dumps(summary))
    session = Session(own)
    session.do(log.edit("delete roots", roots=[1]))
    assert session.measure().roots == 3


def test_a_cut_keeps_volume_and_length_and_moves_laterals(plant: Plant):
    session = Session(plant.result)
    before = session.measure()
    session.do(log.edit("cut", roots=[0], point_mm=tuple(plant.roots[0].points_mm[23])))
    after = session.measure()
    assert after.volume_mm3 == pytest.approx(before.volume_mm3, rel=1e-9)
    assert after.length_mm == pytest.approx(before.length_mm, rel=1e-9)
    found = session.state.lines
    assert (found[1].parent, found[2].parent, found[3].parent, found[4].parent) == (0, 0, 4, 0)
    assert not found[0].tip_seen
    session.do(log.edit("delete roots", roots=[4], laterals=True))
    assert set(session.state.lines) == {0, 1, 2}


def test_a_cut_root_is_whole_again_when_joined(plant: Plant):
    session = Session(plant.result)
    before = session.measure()
    session.do(log.edit("cut", roots=[1], point_mm=tuple(plant.roots[1].points_mm[20])))
    session.do(log.edit("join", roots=[1, 4]))
    assert session.measure().volume_mm3 == pytest.approx(before.volume_mm3, rel=1e-9)
    assert session.measure().length_mm == pytest.approx(before.length_mm, rel=1e-9)
    assert session.state.lines[1].tip_seen


def test_joining_across_a_gap_adds_a_tube(plant: Plant):
    session = Session(plant.result)
    before = session.measure()
    gap = np.linalg.norm(plant.roots[2].points_mm[0] - plant.roots[1].points_mm[-1])
    near_end = min(gap, float(np.linalg.norm(plant.roots[2].points_mm[-1] - plant.roots[1].points_mm[-1])))
    session.do(log.edit("join", roots=[1, 2]))
    after = session.measure()
    assert after.length_mm - before.length_mm == pytest.approx(near_end, rel=1e-6)
    a, b = 0.3 / 2.0, 0.4 / 2.0
    bridge = np.pi / 3.0 * near_end * (a * a + a * b + b * b)
    assert after.volume_mm3 - before.volume_mm3 == pytest.approx(bridge, rel=0.1)  # less what lies inside the main root


def test_a_tip_is_set_and_what_lies_beyond_goes(plant: Plant):
    session = Session(plant.result)
    way = session.state.lines[3].way_mm
    session.do(log.edit("tip", roots=[3], point_mm=tuple(plant.roots[3].points_mm[20])))
    assert session.state.lines[3].length_mm == pytest.approx(way[20])
    assert session.state.lines[3].tip_seen
    assert len(session.state.lines) == 4


def test_parent_and_base_change_the_tree_and_not_the_volume(plant: Plant):
    session = Session(plant.result)
    before = session.measure().volume_mm3
    session.do(log.edit("parent", roots=[2, 1]))
    assert [root.order for root in session.state.roots()] == [0, 1, 2, 1]
    with pytest.raises(UserError, match="which is its descendant"):
        session.do(log.edit("parent", roots=[1, 2]))
    session.do(log.edit("base", roots=[0], point_mm=tuple(plant.roots[0].points_mm[-1])))
    assert session.state.lines[0].points_mm[0] == pytest.approx(plant.roots[0].points_mm[-1])
    assert session.measure().volume_mm3 == pytest.approx(before, rel=1e-9)


def test_a_box_takes_voxels_and_what_of_the_roots_lies_in_it(plant: Plant):
    session = Session(plant.result)
    box = ((-20.0, -20.0, -40.0), (20.0, 20.0, -30.0))
    centre = session.solid.centre_mm
    inside = ((centre >= box[0]) & (centre <= box[1])).all(axis=1)
    expected = session.measure().volumes_mm3[~inside].sum()
    session.do(log.edit("delete box", box_mm=box))
    assert session.measure().volumes_mm3[inside].sum() == 0.0
    assert session.measure().volume_mm3 == pytest.approx(expected, rel=0.06)  # tubes end at their nodes, voxels at their faces
    for line in session.state.lines.values():
        assert not ((line.points_mm >= box[0]) & (line.points_mm <= box[1])).all(axis=1).any()


def test_undo_and_redo_go_all_the_way(plant: Plant):
    session = Session(plant.result)
    volumes = [session.measure().volume_mm3]
    lowest = np.argsort(session.solid.centre_mm[:, 2])[:5]
    for edit in (*(log.edit("delete roots", roots=[root]) for root in (1, 2)), log.edit("delete voxels", runs=log.runs(sorted(lowest)))):
        session.do(edit)
        volumes.append(session.measure().volume_mm3)
    assert volumes == sorted(volumes, reverse=True)
    assert len(set(volumes)) == len(volumes)
    for volume in reversed(volumes[:-1]):
        session.undo()
        assert session.measure().volume_mm3 == volume
    assert not session.can_undo
    for volume in volumes[1:]:
        session.redo()
        assert session.measure().volume_mm3 == volume
    assert session.redo() is session.state
    assert log.runs(range(10, 200)) == ((10, 190),)


def test_a_log_makes_the_same_result_again_and_the_original_stays(plant: Plant, tmp_path: Path):
    files = {path: path.read_bytes() for path in plant.result.rglob("*") if path.is_file() and path.name != log.LOG_NAME}
    session = Session(plant.result)
    session.do(log.edit("delete roots", roots=[1], who="ann"))
    session.do(log.edit("cut", roots=[0], point_mm=(1.0, 0.5, -40.0), who="ben"))
    saved = session.save()
    assert {path: path.read_bytes() for path in files} == files
    made = log.read(saved, plant.result)
    saved.unlink()
    again = Session(plant.result, log=made)
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
    before, after = (result_files.read_mesh(folder / "shape.ply").vertices_mm for folder in (plant.result, tmp_path / "new"))
    assert after[:, 0].max() < 5.0 < before[:, 0].max()  # root 1 went that way
    assert summary["edits"]["who"] == ["ann", "ben"]
    told = result_traits.describe_edits(summary)
    assert told.startswith("2 edits by ann, ben, -")
    assert told in stored_traits.spreadsheet([("a", summary, stored_traits.read(tmp_path / "new"))])
    assert json.loads((tmp_path / "new" / "traits.json").read_text())["edits"] == told


def test_saved_corrections_are_there_when_the_result_is_opened_again(own: Path):
    session = Session(own)
    session.do(log.edit("delete roots", roots=[1], who="ann"))
    session.save()
    again = Session(own)
    assert (len(again.log.edits), again.unsaved) == (1, 0)
    assert again.measure().volume_mm3 == pytest.approx(session.measure().volume_mm3, rel=1e-9)
    again.do(log.edit("delete roots", roots=[2], who="ben"))
    again.save()
    assert [one.who for one in log.read(own / log.LOG_NAME, own).edits] == ["ann", "ben"]
    session.undo()
    with pytest.raises(UserError, match="changed by another session"):
        session.save()
    assert len(log.read(own / log.LOG_NAME, own).edits) == 2


def tree(session: Session) -> dict[int, tuple[int, float, bool]]:
    """Return parent, length and visibility of the tip of each root."""
    return {k: (line.parent, line.length_mm, line.tip_seen) for k, line in session.state.lines.items()}


@pytest.mark.parametrize(
    "deletion",
    [
        {"kind": "delete roots", "roots": [0]},
        {"kind": "delete roots", "roots": [0, 3]},
        {"kind": "tip", "roots": [0], "point_mm": (1.0, 0.5, -40.0)},
        {"kind": "delete box", "box_mm": ((-20.0, -20.0, -40.0), (20.0, 20.0, -30.0))},
        {"kind": "delete box", "box_mm": ((-20.0, -20.0, -60.5), (20.0, 20.0, -30.0))},
        {"kind": "delete box", "box_mm": ((-20.0, -20.0, -70.0), (20.0, 20.0, -20.0))},
    ],
    ids=["root", "root and lateral", "tip", "middle", "lower part", "all below the first lateral"],
)
def test_a_restored_deletion_leaves_no_trace(own: Path, deletion: dict):
    session = Session(own)
    before, measured = tree(session), session.measure()
    count = len(measured.volumes_mm3)
    session.do(log.edit(deletion["kind"], **{key: value for key, value in deletion.items() if key != "kind"}))
    assert session.measure().length_mm < measured.length_mm - 10.0
    session.do(log.edit("restore deletion"))
    assert tree(session) == before
    assert session.measure().volumes_mm3[:count] == pytest.approx(measured.volumes_mm3, abs=1e-6)
    assert session.measure().volume_mm3 == pytest.approx(measured.volume_mm3, rel=1e-6)
    assert not session.state.removed
    assert not session.state.deletions
    session.save()
    assert tree(Session(own)) == before
    with pytest.raises(UserError, match="no deleted roots"):
        session.do(log.edit("restore deletion"))


def test_corrections_after_a_deletion_are_kept_when_it_is_restored(plant: Plant):
    session = Session(plant.result)
    session.do(log.edit("delete roots", roots=[0]))
    session.do(log.edit("parent", roots=[3, 2]))
    session.do(log.edit("delete roots", roots=[1]))
    session.do(log.edit("restore deletion"))
    session.do(log.edit("restore deletion"))
    assert {k: line.parent for k, line in session.state.lines.items()} == {0: -1, 1: 0, 2: 0, 3: 2}
    session.do(log.edit("tip", roots=[0], point_mm=(1.0, 0.5, -40.0)))
    session.do(log.edit("cut", roots=[0], point_mm=(0.5, 0.2, -25.0)))
    shortened, length = session.state.lines[0].length_mm, session.measure().length_mm
    session.do(log.edit("restore deletion"))
    assert session.state.lines[0].length_mm == shortened
    assert session.state.lines[4].parent == 0  # what was cut off at the tip is a root of its own
    assert session.measure().length_mm > length + 10.0


def test_restored_roots_have_their_laterals_again(plant: Plant):
    """Logs of version 0.2 contain this correction in place of "restore deletion"."""
    session = Session(plant.result)
    before = tree(session)
    session.do(log.edit("delete roots", roots=[0]))
    session.do(log.edit("restore roots", roots=[0]))
    assert tree(session) == before
    assert not session.state.deletions


def test_tubes_that_were_undone_leave_nothing_behind(own: Path):
    """Rows of voxels in the log must be those of a session without the undone tube."""
    session = Session(own)
    count, before = len(session.solid.size), session.measure().volume_mm3
    session.do(log.edit("join", roots=[1, 2]))
    joined = session.measure().volume_mm3
    session.undo()
    assert session.measure().volume_mm3 == before
    assert len(session.measure().volumes_mm3) == count
    session.redo()
    assert session.measure().volume_mm3 == joined
    session.undo()
    session.do(log.edit("join", roots=[3, 2]))
    bridge = np.flatnonzero(session.measure().volumes_mm3[count:] > 1e-9) + count
    session.do(log.edit("delete voxels", runs=log.runs(bridge[::2].tolist())))
    session.save()
    again = Session(own)
    assert again.measure().volumes_mm3 == pytest.approx(session.measure().volumes_mm3, abs=1e-9)
    assert again.measure().length_mm == pytest.approx(session.measure().length_mm)


def test_saved_corrections_that_cannot_be_applied_are_kept(own: Path):
    path = own / log.LOG_NAME
    log.write(path, replace(log.new(own), edits=(log.edit("delete roots", roots=[99]),)))
    before = path.read_bytes()
    with pytest.raises(UserError, match=r"root 99 does not exist\); move .*edits.json to open"):
        Session(own)
    assert path.read_bytes() == before


def test_a_result_that_is_corrected_again_lists_all_corrections(plant: Plant, tmp_path: Path):
    volumes, edits = [volume_of(plant.result)], {}
    places = (plant.result, tmp_path / "once", tmp_path / "twice", tmp_path / "thrice")
    for (source, output), who in zip(pairwise(places), ("ben", "ann", "cid"), strict=True):
        session = Session(source)
        session.do(log.edit("delete roots", roots=[1], who=who))
        summary = corrected.write(session, output)
        edits = summary["edits"]
        volumes.append(summary["volume_mm3"])
    assert (edits["count"], edits["who"]) == (3, ["ann", "ben", "cid"])
    assert edits["volume_before_mm3"] == pytest.approx(volumes[0])
    assert edits["volume_share"] == pytest.approx(volumes[-1] / volumes[0] - 1.0)
    made = log.read_applied(places[-1])
    assert [one.edits[0].who for one in made] == ["ben", "ann", "cid"]
    assert made[0] == log.read(places[1] / "corrected.json", plant.result)


def test_a_trait_that_was_not_reliable_is_not_reliable_after_corrections(own: Path, tmp_path: Path):
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
    assert (judged["total_length_mm"].verdict, judged["mean_diameter_mm"].verdict) == ("not reliable", "not assessed")
    assert judged["total_length_mm"].reason == "the roots are too thin"


def test_the_shoot_is_kept_and_its_result_can_be_replaced(own: Path, tmp_path: Path):
    mesh = trimesh.creation.icosphere(radius=5.0)
    numbers = {
        "leaf_area_mm2": 80.0,
        "stalks_mm3": 1.0,
        "leaf_thickness_mm": 0.3,
        "pot_top_mm": 8.0,
        "hidden_share": 0.1,
        "enclosed_share": 0.0,
    }
    shoot = Shoot(mesh=mesh, hull_mm3=500.0, blades_mm2=(80.0,), covered_px={"a": 9.0}, mm2_per_px={"a": 1.0}, **numbers)
    replace(load_result(own), shoot=shoot).save(own)
    session = Session(own)
    session.do(log.edit("delete roots", roots=[1]))
    for _ in range(2):
        corrected.write(session, tmp_path / "new")
        kept = load_result(tmp_path / "new").shoot
        assert kept is not None
        assert kept.mesh.volume == pytest.approx(mesh.volume, rel=1e-5)
        command_steps.refuse_place(tmp_path / "new", own)


def edit(**changes: object) -> dict[str, object]:
    return {"edits": [{"do": "cut", "who": "a", "when": "b"} | changes]}


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"shape_sha256": "0" * 64}, "corrections of a different result"),
        (edit(do="explode"), "'explode'"),
        (edit(file="/etc/passwd"), "unknown key 'file'"),
        (edit(do="delete roots", roots=["x"]), "'x'"),
        (edit(point_mm=[0, 0, float("nan")]), "not a valid point"),
        (edit(do="delete box", box_mm=[]), "could not be read as a log"),
        ({"schema_version": 99}, "schema_version"),
    ],
)
def test_logs_that_are_wrong_are_refused(plant: Plant, tmp_path: Path, change: dict, reason: str):
    path = tmp_path / log.LOG_NAME
    log.write(path, log.new(plant.result))
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    with pytest.raises(UserError, match=reason):
        log.read(path, plant.result)


def test_corrections_that_cannot_be_are_refused_and_change_nothing(plant: Plant):
    session = Session(plant.result)
    for edit in (
        log.edit("delete roots", roots=[99]),
        log.edit("cut", roots=[1], point_mm=tuple(plant.roots[1].points_mm[-1])),
        log.edit("join", roots=[1]),
        log.edit("join", roots=[1, 1]),
        log.edit("delete voxels", runs=((10_000_000, 2),)),
        log.edit("delete voxels", runs=((0, 10**13),)),
        log.edit("delete voxels", runs=((10**30, 1),)),
        log.edit("fit"),
        log.edit("restore roots", roots=[1]),
    ):
        with pytest.raises(UserError):
            session.do(edit)
    assert not session.can_undo


def test_a_line_knows_its_nearest_point_and_parts():
    line = lines.Line(np.array([[0.0, 0, 0], [0, 0, -10]]), np.array([1.0, 0.5]), -1, (lines.Piece(0, 0.0, 10.0),))
    assert line.nearest_mm((3.0, 0.0, -4.0)) == pytest.approx(4.0)
    part = line.between(2.0, 6.0)
    assert part.length_mm == pytest.approx(4.0)
    assert part.pieces == (lines.Piece(0, 2.0, 6.0),)
    assert part.backward().between(1.0, 2.0).pieces == (lines.Piece(0, 5.0, 4.0),)
    assert part.diameters_mm == pytest.approx([0.9, 0.7])


def test_faces_beside_cubes_are_found():
    rng = np.random.default_rng(0)
    points, centre, reach = rng.uniform(-5.0, 5.0, (40_000, 3)), rng.uniform(-3.0, 3.0, (30, 3)), rng.uniform(0.05, 0.4, 30)
    inside = (np.abs(points[:, None] - centre[None]) <= reach[None, :, None]).all(axis=2).any(axis=1)
    found = surface._may_be_inside(points, centre, reach)
    assert inside.sum() > 50
    assert found[inside].all()
    assert found.mean() < 0.3


@pytest.fixture(scope="module")
def pair(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a result of two plants: the plant on paper, and a straight root 14 mm beside it."""
    folder = tmp_path_factory.mktemp("pair")
    one = load_result(plants.make(folder, fibre=True).result)
    roots = tuple(replace(root, plant="B" if k == 4 else "A") for k, root in enumerate(one.solid.roots))
    known = [ScenePlant(plant="A"), ScenePlant(plant="B", at_mm=(-14.0, -10.0), treatment="low N")]
    planted = recon_plants.check_assignment(roots, known, grid_z_mm=-15.0)
    shape = divide_by_plant.Shape(
        leaves=one.solid.voxels,
        surface=one.solid.surface,
        finest_mm=one.solid.finest_mm,
        volume_mm3=one.solid.volume.mm3,
        terms=one.solid.volume.terms,
    )
    found = divide_by_plant.measure(shape, planted, known, Subject(species="Raphanus sativus"))
    whole = replace(one, solid=replace(one.solid, roots=planted.roots), plants=found, subject=Subject(species="Raphanus sativus"))
    (folder / "pair").mkdir()
    whole.save(folder / "pair")
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
