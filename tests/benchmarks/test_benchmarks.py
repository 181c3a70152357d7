"""The benchmarks' runs and command line, with the expensive work replaced."""

import json
import math
from pathlib import Path

import pytest

from benchmarks import __main__ as command
from benchmarks import accuracy, cases, gate, ladder_commands, worker
from benchmarks.cases import Case, Pictures
from benchmarks.metric import Metric
from benchmarks.run import Run
from benchmarks.targets import TARGETS
from rhizotwin.recon.uncertainty import calibration
from rhizotwin.scenes import atomic

PLANT = Pictures(scene="radish_day05a", rings=2, views=3, image_wh=(80, 60))
CASES = [Case(pictures=PLANT), Case(pictures=PLANT, method="thesis")]


def test_every_case_has_its_own_name_and_a_scene_of_the_library():
    for chosen in (cases.quick(), cases.ladder(seeds=(0, 1))):
        assert len({case.name for case in chosen}) == len(chosen)
    wrong = []
    for pictures in {case.pictures for case in cases.ladder() + cases.quick()}:
        scene = pictures.scene_to_render()
        if scene.camera.image_wh != pictures.image_wh or [ring.views for ring in scene.plan.rings] != [pictures.views] * pictures.rings:
            wrong.append(pictures.name)
    assert not wrong


def test_targets_name_measured_things():
    full = {case.name for case in cases.ladder()}
    others = ("render/", "reconstruct/", "projection/", "rig/", "ladder/")
    assert [key for key in TARGETS if not key.startswith(others) and key.rpartition("/")[0] not in full] == []


@pytest.fixture
def fake_worker(monkeypatch, tmp_path, record_of):
    """Answer jobs at once; returns the list of those that were asked for."""
    asked: list[list[str]] = []

    def start(arguments, *, device):
        assert device == "cpu"
        asked.append(arguments)
        if arguments[0] == "projection":
            return {"metrics": []}
        if arguments[0] == "reconstruct":
            if arguments[3] == "thesis":
                raise RuntimeError("ended with code 1\nZeroDivisionError: no views")
            cost = {name: value for name, value in record_of(CASES[0]).items() if name not in ("case", "score")}
            atomic.write_json(Path(arguments[2]) / "cost.json", cost)
        return {"wall": 1.0, "score": record_of(CASES[0])["score"], "summary": {}}

    monkeypatch.setattr(worker, "start", start)
    monkeypatch.setenv("RHIZOTWIN_CACHE", str(tmp_path))
    return asked


@pytest.mark.usefixtures("fake_worker")
def test_a_crashed_case_is_recorded_and_the_rest_go_on():
    said: list[str] = []
    run = accuracy.measure(CASES[::-1], device="cpu", say=said.append)
    assert list(run.crashed) == [CASES[1].name]
    assert "ZeroDivisionError: no views" in run.crashed[CASES[1].name]
    assert {metric.key.rpartition("/")[0] for metric in run.metrics} == {CASES[0].name}
    assert said[0].startswith("2 cases")
    assert "CRASHED" in said[1]
    assert "min left" in said[1]
    assert said[2].endswith("done")
    json.dumps(run.details)


def test_what_was_measured_is_kept_until_something_changes(fake_worker, monkeypatch, tmp_path):
    first = accuracy.measure(CASES, device="cpu", say=lambda _line: None)
    assert [job[0] for job in fake_worker] == ["dataset", "reconstruct", "dataset", "score", "dataset", "reconstruct"]
    fake_worker.clear()
    again = accuracy.measure(CASES, device="cpu", say=lambda _line: None)
    assert [job[0] for job in fake_worker] == ["dataset", "reconstruct"]  # the crashed one only
    assert again.metrics == first.metrics

    def jobs(**given):
        fake_worker.clear()
        accuracy.measure(CASES[:1], device="cpu", say=lambda _line: None, **given)
        return [job[0] for job in fake_worker if job[0] != "dataset"]

    assert jobs() == []
    assert jobs(afresh=True) == ["reconstruct", "score"]
    assert jobs(fault="ghost") == ["score"]  # a fault of the roots, or a changed score, needs no new reconstruction
    digest = accuracy.sources.digest
    monkeypatch.setattr(accuracy.sources, "digest", lambda names, **given: digest(names, **given) + "scoring" * ("scoring" in names[0]))
    assert jobs() == ["score"]
    (tmp_path / "calibration.json").write_text("{}", encoding="utf-8")
    monkeypatch.setattr(calibration, "TABLE", tmp_path / "calibration.json")
    assert jobs() == ["reconstruct", "score"]


def test_a_stage_that_gave_nothing_is_not_a_number_and_fails(record_of, tmp_path):
    record = record_of(CASES[0])
    measured = {metric.key.rpartition("/")[2]: metric for metric in accuracy.metrics(CASES[0], record)}
    assert measured["volume_error"].value == 0.01
    assert measured["interval_holds"].value == 1.0
    assert measured["length_error"].value == -0.02
    assert measured["pose_median_mm"].value == 0.03
    record["score"]["poses"] = record["score"]["roots"] = record["score"]["topology"] = None  # a plant in which no roots were found
    lost = {metric.key.rpartition("/")[2]: metric for metric in accuracy.metrics(CASES[0], record)}
    assert math.isnan(lost["pose_median_mm"].value)
    assert math.isnan(lost["length_error"].value)
    values = {metric.key: {"value": 0.0, "unit": metric.unit} for metric in lost.values()}
    (tmp_path / "b.json").write_text(json.dumps({"schema_version": 1, "metrics": values}))
    found = {f.key: f.verdict for f in gate.compare(list(lost.values()), gate.read_baseline(tmp_path / "b.json"))}
    assert found[lost["length_error"].key] == "NOT A NUMBER"


def test_update_then_gate_then_fail(monkeypatch, capsys, tmp_path):
    def metric(value):
        return [Metric(key=f"{cases.quick()[0].name}/iou", value=value, unit="1", direction="up")]

    run = Run(metrics=metric(0.9))
    monkeypatch.setattr(accuracy, "measure", lambda *_, **_given: run)
    monkeypatch.setattr(accuracy, "projection", lambda _device: [])
    monkeypatch.setattr(ladder_commands, "HERE", tmp_path)
    monkeypatch.setenv("RHIZOTWIN_CACHE", str(tmp_path / "cache"))
    arguments = ["accuracy", "--quick", "--device", "cpu"]
    assert command.main([*arguments, "--gate"]) == 2
    assert "baseline_accuracy_quick.json" in capsys.readouterr().err
    assert command.main([*arguments, "--update-baseline"]) == 0
    assert command.main([*arguments, "--gate"]) == 0
    run.metrics = metric(0.8)
    assert command.main([*arguments, "--gate"]) == 1
    assert "WORSE" in capsys.readouterr().out
    run.crashed["job"] = "boom"
    assert command.main(arguments) == 1
    assert command.main([*arguments, "--update-baseline"]) == 2
    stored = json.loads((tmp_path / "cache" / "results" / "accuracy_quick.json").read_text())
    assert stored["metrics"][run.metrics[0].key]["value"] == 0.8
    assert stored["about"]["python"]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--scenes", "sphere*", "--seeds", "7", "--gate"], "does not contain sphere_20mm/clean"),
        (["--quick", "--scenes", "sphere*", "--update-baseline"], "cannot become the baseline"),
        (["--quick", "--change", "rounded:1", "--update-baseline"], "changed pictures"),
        (["--fault", "tips", "--update-baseline"], "changed pictures"),
        (["--nightly", "--rings", "2"], "--nightly is a set of its own"),
        (["--scenes", "fallen_plant", "--profiles", "harsh"], "no case of the ladder"),
        (["--quick", "--seeds", "1"], "the quick set has no seeds"),
        (["--quick", "--rings", "1"], "the quick set has no rings"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_part_of_the_cases_is_no_baseline_and_nothing_is_none(words, said, capsys):
    assert command.main(["accuracy", *words]) == 2
    assert said in capsys.readouterr().err
