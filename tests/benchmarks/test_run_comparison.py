"""Two runs compared case by case, and frozen cases: what is kept, what a comparison finds, and bad input."""

import json
import math
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks import __main__ as command
from benchmarks import frozen, run_comparison, worker
from benchmarks.cases import Case, ladder
from rhizotwin.scenes import atomic
from rhizotwin.scenes.errors import UserError
from rhizotwin.stored.load import load_result
from tests.rhizotwin import plant

CASES = ladder(scenes=("radish_day05*", "radish_day10*"), seeds=(0, 1), rings=(1,), methods=("coverage",))[:12]


def test_mean_interval_and_sign_test_by_hand():
    found = run_comparison.difference([5.0, 4.0, 6.0, 8.0], [3.0, 3.0, 3.0, 6.0], run_comparison.COMPARED[0])
    assert (found.before, found.after, found.mean) == (5.75, 3.75, -2.0)
    reach = 3.182446 * math.sqrt(2.0 / 3.0) / 2.0  # t(0.975, 3) sd / sqrt(n)
    assert (found.low, found.high) == (pytest.approx(-2.0 - reach, abs=1e-5), pytest.approx(-2.0 + reach, abs=1e-5))
    assert (found.better, found.worse, found.p_sign) == (4, 0, pytest.approx(0.125))


def write(path, records, crashed=()):
    details = {record["case"]["name"]: record for record in records}
    path.write_text(json.dumps({"about": {}, "metrics": {}, "crashed": dict.fromkeys(crashed, "Error"), "details": details}))
    return path


def row(said, name):
    """Return pairs, better and worse of a number."""
    line = next(line for line in said.splitlines() if line.startswith(name))
    return [int(word) for word in line.split("  p =")[0].split()[-3:]]


def test_what_is_missing_or_failed_in_the_second_run_is_worse(tmp_path, record_of, capsys):
    before = [record_of(case) for case in CASES]
    after = [record_of(case) for case in CASES[1:]]
    after[0]["score"]["volume_error"] = None
    before[2]["score"]["volume_error"] = None
    after[3]["score"]["roots"] = None
    a, b = write(tmp_path / "a.json", before), write(tmp_path / "b.json", after, crashed=[CASES[0].name])
    assert command.main(["compare", str(a), str(b)]) == 0
    said = capsys.readouterr().out
    assert "11 cases in both, 0 only in A, 0 only in B" in said
    assert f"failed in B: {CASES[0].name}\n" in said
    assert row(said, "volume error (size)") == [9, 1, 2]
    assert row(said, "tip recall") == [10, 0, 2]
    assert row(said, "memory") == [11, 0, 1]
    none = write(tmp_path / "none.json", [], crashed=[case.name for case in CASES])
    assert command.main(["compare", str(a), str(none)]) == 0
    assert row(capsys.readouterr().out, "time") == [0, 0, 12]


def test_runs_that_share_nothing_and_other_files_are_refused(tmp_path, record_of, capsys):
    a, b = (write(tmp_path / f"{k}.json", [record_of(case)]) for k, case in enumerate(CASES[:2]))
    assert command.main(["compare", str(a), str(b)]) == 2
    assert "have no case" in capsys.readouterr().err
    path = tmp_path / "run.json"
    for content in (None, "{", "[]", "{}", '{"details": {"a": 3}}', '{"details": {}}'):
        if content is not None:
            path.write_text(content)
        with pytest.raises(UserError, match=r"run\.json"):
            run_comparison.read_cases(path)


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
