"""The benchmarks' runs and command line, with the expensive work replaced."""

import json
import math

import pytest

from benchmarks import __main__ as command
from benchmarks import accuracy, cases, gate, speed
from benchmarks.cases import Case, Pictures
from benchmarks.metric import Metric

CASES = [Case(pictures=Pictures(scene="sphere_20mm")), Case(pictures=Pictures(scene="sphere_20mm"), method="thesis")]


def test_case_names_are_unique_and_targets_name_measured_things():
    for quick in (True, False):
        names = [case.name for case in cases.ladder(quick=quick)]
        assert len(set(names)) == len(names)
    full = {case.name for case in cases.ladder(quick=False)}
    for key in cases.TARGETS:
        assert key.startswith(("render/", "reconstruct/", "projection/", "rig/")) or key.rpartition("/")[0] in full


@pytest.mark.parametrize("case", cases.ladder(quick=False) + cases.ladder(quick=True), ids=lambda case: case.name)
def test_every_case_is_in_the_library(case):
    scene = case.pictures.scene_to_render()
    assert scene.camera.image_wh == case.pictures.image_wh
    assert sum(ring.views for ring in scene.plan.rings) == case.pictures.views


def test_a_crashed_case_is_recorded_and_the_rest_go_on(monkeypatch, scan_score, tmp_path):
    def reconstruct_and_score(case, _folder):
        if case.method == "thesis":
            raise ZeroDivisionError("no views")
        return scan_score

    monkeypatch.setattr(accuracy, "dataset", lambda _pictures, *, sources: tmp_path / sources)
    monkeypatch.setattr(accuracy, "reconstruct_and_score", reconstruct_and_score)
    said: list[str] = []
    run = accuracy.measure(CASES[::-1], say=said.append)
    assert list(run.crashed) == [CASES[1].name]
    assert "ZeroDivisionError: no views" in run.crashed[CASES[1].name]
    assert {metric.key.rpartition("/")[0] for metric in run.metrics} == {CASES[0].name, "projection"}
    assert any("CRASHED" in line for line in said)
    json.dumps(run.details)


@pytest.fixture
def scan_score():
    from recon.score import Score
    from recon.score_shape import HullScore, SurfaceScore, VoxelScore

    return Score(
        scene="ball",
        voxel_mm=0.27,
        volume_mm3=99.0,
        volume_true_mm3=100.0,
        volume_error=-0.01,
        volume_interval_mm3=(95.0, 105.0),
        interval_holds_truth=True,
        extents_mm=(1.0, 1.0, 1.0),
        extents_true_mm=(1.0, 1.0, 1.0),
        extents_error=(0.0, 0.0, 0.0),
        extents_error_max=0.0,
        voxels=VoxelScore(recall=0.9, precision=0.8, iou=0.7, recall_weighted=0.9, precision_weighted=0.8, iou_weighted=0.7),
        surface=SurfaceScore(
            median_mm=0.1,
            p95_mm=0.2,
            result_to_truth_median_mm=0.1,
            result_to_truth_p95_mm=0.2,
            truth_to_result_median_mm=0.1,
            truth_to_result_p95_mm=0.2,
        ),
        poses=None,
        masks=None,
        hull=HullScore(recall=1.0, volume_mm3=110.0, volume_error=0.1, kept_recall=1.0, leaf_count_volume_mm3=98.0),
        roots=None,
        blind_mm3=0.0,
        timings_s={},
        peak_memory_mib=None,
        warnings=(),
    )


def test_a_stage_that_gave_nothing_is_not_a_number_and_fails(scan_score, tmp_path):
    measured = {metric.key: metric for metric in accuracy.metrics("ball", scan_score)}
    assert measured["ball/volume_error"].value == -0.01
    assert math.isnan(measured["ball/pose_median_mm"].value)
    (tmp_path / "b.json").write_text(
        json.dumps({"schema_version": 1, "metrics": {k: {"value": 0.0, "unit": m.unit} for k, m in measured.items()}})
    )
    found = {f.key: f.verdict for f in gate.compare(list(measured.values()), gate.read_baseline(tmp_path / "b.json"))}
    assert found["ball/pose_median_mm"] == "NOT A NUMBER"


@pytest.fixture
def fake_speed(monkeypatch, tmp_path):
    """Let the command line run with numbers that the test chooses."""
    measured = [Metric(key="job/wall", value=2.0, unit="s", direction="down", rel_tol=0.5)]
    run = accuracy.Run(metrics=measured)
    monkeypatch.setattr(speed, "measure", lambda **_given: run)
    monkeypatch.setattr(command, "HERE", tmp_path)
    monkeypatch.setenv("RHIZOTWIN_CACHE", str(tmp_path / "cache"))
    return run


def test_update_then_gate_then_fail(fake_speed, capsys, tmp_path):
    arguments = ["speed", "--device", "cpu"]
    assert command.main([*arguments, "--gate"]) == 2
    assert "baseline_speed.json" in capsys.readouterr().err
    assert command.main([*arguments, "--update-baseline"]) == 0
    assert command.main([*arguments, "--gate"]) == 0
    fake_speed.metrics = [Metric(key="job/wall", value=4.0, unit="s", direction="down", rel_tol=0.5)]
    assert command.main([*arguments, "--gate"]) == 1
    assert "WORSE" in capsys.readouterr().out
    fake_speed.crashed["job"] = "boom"
    assert command.main(arguments) == 1
    assert command.main([*arguments, "--update-baseline"]) == 2
    stored = json.loads((tmp_path / "cache" / "results" / "speed.json").read_text())
    assert stored["metrics"]["job/wall"]["value"] == 4.0
    assert stored["about"]["python"]


def test_part_of_the_cases_can_neither_gate_nor_become_the_baseline(capsys):
    for flag in ("--gate", "--update-baseline"):
        assert command.main(["accuracy", "--only", "sphere", flag]) == 2
    assert "--only" in capsys.readouterr().err


def test_a_failing_job_is_reported_with_its_output(monkeypatch, tmp_path):
    monkeypatch.setattr(accuracy, "dataset", lambda _pictures, **_given: tmp_path / "none")
    monkeypatch.setattr(speed, "worker", _broken_worker)
    run = speed.measure(quick=True, device="cpu", say=lambda _line: None)
    assert set(run.crashed) == {"render/backlit/800x600", "reconstruct/40x800x600/0.27"}
    assert "code 3" in next(iter(run.crashed.values()))


def _broken_worker(arguments, *, device):
    raise RuntimeError(f"{arguments} on {device} ended with code 3")


def test_a_worker_that_cannot_do_its_job_raises(tmp_path):
    with pytest.raises(RuntimeError, match="ended with code"):
        speed.worker(["reconstruct", str(tmp_path), "0.27"], device="cpu")
