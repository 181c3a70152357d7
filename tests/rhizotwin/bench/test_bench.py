"""Benchmarks for any method: sets that are the same everywhere, methods that work or fail, tables, pages and gates."""

import json
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path
from subprocess import PIPE
from typing import Any

import pytest

from rhizotwin.bench import benchmarks, fingerprints, offers, results, run_method, supervisor
from rhizotwin.bench.benchmarks import Benchmark, Case
from rhizotwin.scenes.dataset import load_dataset
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.truth import load_truth, save_truth
from rhizotwin.sim import simulate as simulation
from tests.command import Command
from tests.rhizotwin.browser import until

ROOT = Path(__file__).resolve().parents[3]
EXAMPLE = ROOT / "examples" / "methods" / "hull_by_voxels.py"
TINY = Benchmark(
    name="tiny-1",
    description="one ball",
    cases=(Case(name="ball", scene="sphere_20mm", profile="clean", views=10, image_wh=(320, 240), seed=0),),
)


@pytest.fixture(scope="module")
def offered(made: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("offered") / "dataset"
    offers.offer(made, folder, cameras="estimated")
    return folder


@pytest.fixture
def tiny(made: Path, offered: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a folder with the small benchmark, whose cameras are not estimated anew for every run."""
    monkeypatch.setitem(benchmarks.BENCHMARKS, TINY.name, TINY)
    monkeypatch.setattr(run_method, "offer", lambda _, goal, **__: shutil.copytree(offered, goal))
    shutil.copytree(made, tmp_path / "sets" / "ball")
    return tmp_path / "sets"


def row(**scores: Any) -> dict[str, Any]:
    return {"case": "ball", "state": "done", "sentence": "", "cpu_s": 10.0, "memory_mib": 500.0, "scores": scores}


def of_rows(*rows: dict[str, Any]) -> results.Results:
    return results.Results(benchmark="tiny-1", method="mine", cameras="true", rows={one["case"]: one for one in rows})


def with_volume(error: float, low: float, high: float) -> dict[str, Any]:
    holds = low <= 1.0 <= high
    return {"traits": {"volume": {"error": error, "holds": holds, "interval": [low, high], "interval_score": high - low}}}


@pytest.mark.parametrize("benchmark", benchmarks.BENCHMARKS.values(), ids=lambda benchmark: benchmark.name)
def test_every_named_benchmark_can_be_rendered(benchmark: Benchmark) -> None:
    assert len({case.name for case in benchmark.cases}) == len(benchmark.cases)
    assert min(case.seed for case in benchmark.cases) >= benchmarks.HELD_BACK
    assert [len(case.rendered_scene().plan.rings) for case in benchmark.cases] == [case.rings for case in benchmark.cases]
    reference = fingerprints.reference(benchmark)
    if benchmark.name in ("quick-1", "hard-1"):
        views = {case.name: case.views * case.rings for case in benchmark.cases}
        assert {name: len(reference[name]["pixels"]) for name in views} == views


def test_pictures_equal_up_to_rounding_are_the_same_data(command: Command, made: Path, tiny: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    known = fingerprints.take(made)
    others = [{**known, "pixels": [[value + step for value in view] for view in known["pixels"]]} for step in (0, 40, 200)]  # of 65535
    assert [fingerprints.compare(made, "ball", {"ball": other}).same for other in others] == [True, True, False]
    monkeypatch.setattr(simulation, "simulate", lambda *_, **__: None)
    monkeypatch.setattr(fingerprints, "reference", lambda _: {"ball": {**known, "pixels": known["pixels"][1:]}})
    said = command.fails("bench", "make", "tiny-1", "-o", tiny, "--device", "cpu", named=["the pictures of ball", "differ"])
    assert "number of pictures is DIFFERENT" in said.out


def test_what_is_offered_holds_no_truth_but_the_true_cameras(made: Path, offered: Path, tmp_path: Path) -> None:
    names = {"colmap", "dataset.json", "images", "masks", "transforms.json", "undistorted"}
    assert {path.name for path in offered.iterdir()} == names
    cameras = json.loads((offered / "undistorted" / "transforms.json").read_text())
    assert len(cameras["frames"]) == len(list((offered / "undistorted" / "masks").iterdir())) == 10
    assert not any("truth" in path.name for path in offered.rglob("*"))
    shutil.copytree(made, tmp_path / "made")
    truth = load_truth(made)
    save_truth(tmp_path / "made", replace(truth, drawn={**truth.drawn, "focal_error": 0.003}))
    offers.offer(tmp_path / "made", tmp_path / "offered", cameras="true")
    focal_px = load_dataset(made).scene.camera.focal_px[0]
    written = [json.loads((tmp_path / "offered" / folder / "transforms.json").read_text()) for folder in ("", "undistorted")]
    assert [cameras["fl_x"] for cameras in written] == pytest.approx([1.003 * focal_px] * 2)


def test_a_method_of_twenty_lines(command: Command, tiny: Path, tmp_path: Path) -> None:
    assert EXAMPLE.read_text(encoding="utf-8") in (ROOT / "docs" / "benchmark.md").read_text(encoding="utf-8")
    method = f"{sys.executable} {EXAMPLE} {{dataset}} {{output}}"
    words = ["bench", "run", "tiny-1", tiny, "--method", method, "--label", "voxel centres"]
    said = command.works(*words, "-o", tmp_path / "mine.json", "--keep", tmp_path / "kept").out
    assert "voxel centres" in said
    (found,) = json.loads((tmp_path / "mine.json").read_text())["rows"]
    assert found["state"] == "done"
    assert found["cpu_s"] > 0.0
    assert 0.2 < found["scores"]["voxels"]["iou"] < 0.9  # it sees the ball, and no refraction
    again = ["bench", "score", "tiny-1", tiny, tmp_path / "kept", "--label", "again", "-o", tmp_path / "again.json"]
    command.works(*again)
    assert json.loads((tmp_path / "again.json").read_text())["rows"][0]["scores"] == found["scores"]
    assert "again" in command.works("bench", "table", tmp_path / "mine.json", tmp_path / "again.json").out
    command.works("bench", "gate", tmp_path / "again.json", "--baseline", tmp_path / "again.json")


@pytest.mark.parametrize(
    ("program", "state", "word"),
    [
        ("import sys; sys.exit('too few corners')", "failed", "too few corners"),
        ("import time; time.sleep(60)", "timeout", "stopped at the time limit of 1 s"),
        ("import sys, pathlib; p = pathlib.Path(sys.argv[1]); p.mkdir(); (p / 'shape.ply').write_text('no')", "unreadable", "shape.ply"),
    ],
)
def test_a_method_that_goes_wrong_is_a_row(command: Command, tiny: Path, tmp_path: Path, program: str, state: str, word: str) -> None:
    (tmp_path / "method.py").write_text(program)
    method = f"{sys.executable} {tmp_path / 'method.py'} {{output}}"
    command.works(
        "bench", "run", "tiny-1", tiny, "--method", method, "--timeout-s", 1 if state == "timeout" else 60, "-o", tmp_path / "rows.json"
    )
    (found,) = json.loads((tmp_path / "rows.json").read_text())["rows"]
    assert found["state"] == state
    assert word in found["sentence"]
    assert str(tmp_path) not in found["sentence"]


ESCAPES = '(setsid sh -c \'echo $$ > "$0.new"; mv "$0.new" "$0"; exec sleep 600\' "$0" &); sleep 600'
"""Method whose process has a session of its own, and no parent."""


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere, processes that have left the tree are not found")
@pytest.mark.parametrize("ended", ["time limit", "killed"])
def test_no_process_outlives_its_case(tmp_path: Path, ended: str) -> None:
    folder, found = tmp_path / "case", tmp_path / "pid"
    folder.mkdir()
    task = {"words": ["sh", "-c", ESCAPES, str(found)], "timeout_s": 1.0 if ended == "time limit" else 600.0}
    with subprocess.Popen([sys.executable, "-I", supervisor.__file__, folder], stdin=PIPE, stdout=PIPE, text=True) as process:
        process.stdin.write(json.dumps(task) + "\n")
        process.stdin.flush()
        until(found.is_file)
        if ended == "time limit":
            assert json.loads(process.stdout.readline()) == {"timeout": True}
            assert folder.exists(), "its output is scored"
    assert not Path("/proc", found.read_text().strip()).exists()
    assert not folder.exists()


def test_a_benchmark_goes_on_where_it_stopped(command: Command, tiny: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    several = replace(TINY, cases=(TINY.cases[0], replace(TINY.cases[0], name="other")))
    monkeypatch.setitem(benchmarks.BENCHMARKS, TINY.name, several)
    shutil.copytree(tiny / "ball", tiny / "other")
    count, kept, rows = tmp_path / "count", tmp_path / "kept", tmp_path / "rows.json"
    (tmp_path / "method.py").write_text(
        f"import sys, pathlib; pathlib.Path('{count}').open('a').write('.'); p = pathlib.Path(sys.argv[1]); p.mkdir(); "
        "(p / 'points.xyz').write_text('0 0 -20\\n1 0 -20\\n')"
    )
    method = f"{sys.executable} {tmp_path / 'method.py'} {{output}}"
    words = ["bench", "run", "tiny-1", tiny, "--method", method, "-o", rows, "--keep", kept]
    command.works(*words)
    command.fails(*words, named=["kept/ball already exists"])  # a complete run is begun anew
    stored = json.loads(rows.read_text())
    rows.write_text(json.dumps({**stored, "rows": stored["rows"][:1]}))  # as if it had been stopped there
    assert "ball: done (from an earlier run)" in command.works(*words).out
    assert [one["case"] for one in json.loads(rows.read_text())["rows"]] == ["ball", "other"]
    assert (count.read_text(), sorted(path.name for path in kept.iterdir())) == ("...", ["ball", "other"])


def test_a_complete_run_is_replaced_by_a_complete_one(
    command: Command, tiny: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The repetition is stopped after one of three cases, and before the second is stored again when it continues."""
    several = replace(TINY, cases=tuple(replace(TINY.cases[0], name=name) for name in ("a", "b", "c")))
    monkeypatch.setitem(benchmarks.BENCHMARKS, TINY.name, several)
    for case in several.cases:
        shutil.copytree(tiny / "ball", tiny / case.name)
    calls, rows = list[str](), tmp_path / "rows.json"

    def once(case: str, *_: object) -> run_method.Row:
        calls.append(case)
        if len(calls) == 5:
            raise KeyboardInterrupt
        return run_method.Row(case=case, state="done", sentence=str(len(calls)))

    monkeypatch.setattr(run_method, "_run_case", once)
    words = ["bench", "run", "tiny-1", tiny, "--method", "m {output}", "-o", rows]
    command.works(*words)
    assert command(*words).code != 0
    first = json.loads(rows.read_text())
    command.works(*words)
    assert [row["sentence"] for row in first["rows"]] == ["1", "2", "3"]
    assert [row["sentence"] for row in json.loads(rows.read_text())["rows"]] == ["4", "6", "7"]
    assert calls == ["a", "b", "c", "a", "b", "b", "c"]
    assert [path.name for path in tmp_path.glob("rows*")] == ["rows.json"]


def test_hostile_numbers_and_cases_of_a_foreign_file(command: Command, tmp_path: Path) -> None:
    iou = next(one for one in results.QUANTITIES if one.name == "iou")
    hostile = (10**400, -(10**400), float("nan"), float("inf"), True, "1")
    assert [results.value(row(mesh={"iou": number}), iou) for number in hostile] == [None] * len(hostile)
    stored = {"schema_version": 1, "benchmark": "tiny-1", "method": "m<i>", "rows": [row(mesh={"iou": 0.9}) | {"case": 5}]}
    (tmp_path / "rows.json").write_text(json.dumps(stored))
    assert "| 5 | m<i> |" in command.works("bench", "table", tmp_path / "rows.json").out
    command.works("bench", "table", tmp_path / "rows.json", "-o", tmp_path / "page.html")
    assert "<i>" not in (tmp_path / "page.html").read_text(encoding="utf-8")


def test_what_cannot_run_is_one_sentence(command: Command, tiny: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    words = ["-o", tmp_path / "rows.json"]
    command.fails("bench", "run", "tiny-1", tiny, "--method", "neither", *words, named=["{output}", "thesis"])
    command.fails("bench", "run", "tiny-1", tiny, "--method", "python 'my method.py {output}", *words, named=["quotation"])
    command.fails("bench", "run", "tiny-1", tmp_path / "no", "--method", "ours", *words, named=["bench make tiny-1"])
    monkeypatch.setitem(benchmarks.BENCHMARKS, TINY.name, replace(TINY, cases=(replace(TINY.cases[0], seed=1000),)))
    score = ("bench", "score", "tiny-1", tiny, tmp_path, "--label", "mine")
    command.fails(*score, *words, named=["was rendered for another benchmark than tiny-1"])


@pytest.mark.parametrize("method", ["hull", "thesis", "regularised"])
def test_baselines_trust_no_volume(command: Command, made: Path, tmp_path: Path, method: str) -> None:
    out = tmp_path / method
    assert "not reliable" in command.works("reconstruct", made, "-o", out, "--method", method, "--voxel-mm", "1", "--quiet").out
    if method == "hull":
        found = json.loads(command.works("score", out, made, "--json").out)
        assert found["volume_trusted"] is False
        assert abs(found["volume_error"]) < 0.06  # a ball is its own hull
        command.fails("reconstruct", made, "-o", tmp_path / "no", "--method", method, "--mass-g", "2", named=["--mass-g"])


def test_the_gate_sees_what_gets_worse(command: Command, tmp_path: Path) -> None:
    before = of_rows(row(mesh={"iou": 0.9}, traits=with_volume(-0.01, 0.95, 1.05), trusted=True))
    for now, worse in (
        (row(mesh={"iou": 0.9}, traits=with_volume(-0.01, 0.95, 1.05), trusted=True), set()),
        (row(mesh={"iou": 0.9}, traits=with_volume(-0.01, 0.95, 1.05), trusted=False), {"reliability"}),
        (row(mesh={"iou": 0.895}, traits=with_volume(0.012, 0.95, 1.05)), set()),
        (row(mesh={"iou": 0.85}, traits=with_volume(-0.01, 0.95, 1.05)), {"iou"}),
        (row(mesh={"iou": 0.9}, traits=with_volume(0.03, 0.95, 1.05)), {"volume_error"}),
        (row(mesh={"iou": 0.9}, traits=with_volume(-0.01, 1.01, 1.05)), {"interval"}),
        (row(mesh={"iou": 0.9}, traits=with_volume(-0.01, 0.9, 1.1)), {"volume_interval_score"}),
        ({**row(), "state": "failed"}, {"state"}),
    ):
        findings = results.compare(of_rows(now), before)
        assert {one.quantity for one in findings if one.worse} == worse
    stored = {"schema_version": 1, "benchmark": "tiny-1", "method": "mine", "cameras": None}
    for name, iou in (("good", 0.9), ("bad", 0.5)):
        (tmp_path / f"{name}.json").write_text(json.dumps({**stored, "rows": [row(mesh={"iou": iou})]}))
    done = command("bench", "gate", tmp_path / "bad.json", "--baseline", tmp_path / "good.json", "--junit", tmp_path / "gate.xml")
    assert done.code == 1
    assert "ball, iou: 0.5" in done.out
    assert ET.parse(tmp_path / "gate.xml").getroot()[0].get("failures") == "1"
    with pytest.raises(UserError, match="no case in the baseline was completed"):
        results.compare(before, of_rows({**row(), "state": "failed"}))
    with pytest.raises(UserError, match="--cameras estimated"):
        results.compare(before, replace(before, cameras="estimated"))
    assert results.compare(before, replace(before, cameras=None))  # output from another computer
