"""Frozen cases: what is kept, what a comparison finds, and bad input."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks import __main__ as command
from benchmarks import frozen, worker
from benchmarks.cases import Case
from rhizotwin.scenes import atomic
from rhizotwin.stored.load import load_result
from tests.rhizotwin import plant

BEAN = Case(pictures=frozen.CASES["bean"])


@pytest.fixture
def jobs(monkeypatch, tmp_path, record_of):
    """Answer jobs at once with a result made on paper; return their names."""
    made, asked = plant.make(tmp_path / "plant"), []

    def start(arguments, **_given):
        asked.append(arguments[0])
        if arguments[0] == "reconstruct":
            goal = Path(arguments[2])
            shutil.copytree(made.result, goal / "result")
            (goal / "stages").mkdir()
            np.savez(goal / "stages" / "cameras.npz", poses=np.eye(4))
            atomic.write_json(goal / "cost.json", {"cpu_s": 50.0, "wall_s": 30.0, "peak_memory_mib": 900.0})
        return {"score": record_of(BEAN)["score"] | {"traits": {"mean_diameter": {"error": 0.01}}}, "summary": {}}

    monkeypatch.setattr(worker, "start", start)
    monkeypatch.setattr(frozen.datasets, "is_ready", lambda _pictures: True)
    monkeypatch.setattr(frozen.datasets, "place", lambda _pictures: made.dataset)
    monkeypatch.setenv("RHIZOTWIN_CACHE", str(tmp_path / "cache"))
    return asked


def run(*words):
    return command.main([*map(str, words), "--device", "cpu"])


def test_cases_are_frozen_once_and_compared_with_the_code(jobs, tmp_path, capsys):
    folder = tmp_path / "frozen"
    assert run("freeze", "-o", folder, "--cases", "bean") == 0
    assert {path.name for path in (folder / "bean").iterdir()} == {"dataset", "result", "stages", "score.json", "cost.json"}
    assert jobs == ["reconstruct", "score"]
    assert run("freeze", "-o", folder, "--cases", "bean,wheat") == 0
    assert jobs == ["reconstruct", "score", "score"]  # the second case only, whose pictures are the same here
    assert json.loads((folder / "frozen.json").read_text())["cases"] == ["bean", "wheat"]
    assert "| bean | +1.0 | -2.0 | +1.0 |" in capsys.readouterr().out
    assert run("against", folder, "--cases", "wheat", "-o", tmp_path / "against.json") == 0
    stored = json.loads((tmp_path / "against.json").read_text())["cases"]
    assert [row["name"] for row in stored] == ["wheat"]
    assert [change["kind"] for change in stored[0]["changes"]] == ["cameras", "opacity", "hull", "tubes", "links", "terms", "stages"]
    assert all(change["same"] for change in stored[0]["changes"])


def test_each_kind_of_change_is_found_by_itself(tmp_path):
    before = load_result(plant.make(tmp_path / "again").result)
    solid = before.solid
    thicker = [replace(root, diameters_mm=1.1 * root.diameters_mm) for root in solid.roots]
    moved = np.array(before.cameras[0].cam_from_canister)
    moved[0, 3] += 0.01
    darker = {name: replace(one, coverage=0.9 * one.coverage) for name, one in before.silhouettes.items()}
    wider = replace(solid.volume.terms[0], more_mm3=2.0 * solid.volume.terms[0].more_mm3 + 1.0)
    changed = {
        "cameras": replace(before, cameras=(replace(before.cameras[0], cam_from_canister=moved), *before.cameras[1:])),
        "opacity": replace(before, silhouettes=darker),
        "hull": replace(before, solid=replace(solid, hull=replace(solid.hull, occupancy=0.5 * solid.hull.occupancy))),
        "tubes": replace(before, solid=replace(solid, roots=tuple(thicker))),
        "links": replace(before, solid=replace(solid, roots=(*solid.roots[:-1], replace(solid.roots[-1], parent=-1, order=0)))),
        "terms": replace(before, solid=replace(solid, volume=replace(solid.volume, terms=(wider, *solid.volume.terms[1:])))),
    }
    found = {kind: [one.kind for one in frozen.describe(before, after) if not one.same] for kind, after in changed.items()}
    assert found == {kind: [kind] for kind in changed}


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("freeze", "--cases", "bean,oak"), "there is no frozen case 'oak'"),
        (("against", "{}/nowhere"), "is not a folder of frozen cases"),
        (("against", "{}/damaged"), "is damaged"),
        (("against", "{}/other", "--cases", "oak"), "there is no frozen case 'oak'"),
        (("against", "{}/other"), "cannot be read"),
        (("against", "{}/bare"), "volume_error is missing"),
        (("freeze", "-o", "{}/other", "--cases", "bean"), "choose another folder"),
        (("freeze", "-o", "{}/full", "--cases", "bean"), "is not a folder of frozen cases"),
    ],
)
def test_bad_input_is_one_sentence(tmp_path, words, said, capsys):
    known = '{"schema_version": 1, "commit": "0123abcd", "cases": ["bean"]}'
    contents = {"damaged": "[]", "other": known, "bare": known}
    atomic.write_text(tmp_path / "bare" / "bean" / "score.json", "{}")
    for name, text in contents.items():
        atomic.write_text(tmp_path / name / "frozen.json", text)
    atomic.write_text(tmp_path / "full" / "notes.txt", "mine")
    assert run(*(word.format(tmp_path) for word in words)) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1
