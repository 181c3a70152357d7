"""Corrected results: volume, traits and their reliability, shoot, and the record of corrections."""

import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import trimesh

from rhizotwin import command_steps
from rhizotwin.corrections import corrected, log
from rhizotwin.corrections.session import Session
from rhizotwin.recon.results import assessments, result_traits
from rhizotwin.recon.shoots.shoot import Shoot
from rhizotwin.recon.uncertainty.checks import Estimate
from rhizotwin.stored import result_files, stored_traits
from rhizotwin.stored.load import load_result
from tests.rhizotwin.plant import Plant


def volume_of(folder: Path) -> float:
    leaves = result_files.read_leaves(folder)
    return float((leaves.occupancy.astype(np.float64) * (leaves.size * leaves.voxel_mm) ** 3).sum())


def test_nothing_done_changes_nothing(plant: Plant):
    session = Session(plant.result)
    assert session.measure().volume_mm3 == pytest.approx(volume_of(plant.result), rel=1e-6)
    assert session.measure().length_mm == pytest.approx(load_result(plant.result).solid.length_mm)


def test_a_log_makes_the_same_result_again_and_the_original_stays(own: Path, tmp_path: Path):
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
