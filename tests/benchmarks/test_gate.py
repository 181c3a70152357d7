"""The gate: what is worse, missing, crashed, not a number or unknown shuts it, and so does each deliberate fault of a tree."""

import json
import math
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path

import pytest

from benchmarks import accuracy, gate, tree_faults
from benchmarks.cases import Case, Pictures
from benchmarks.metric import Metric
from benchmarks.targets import TARGETS
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.rsml import length_mm
from rhizotwin.scoring.score_roots import compare_roots
from rhizotwin.scoring.score_topology import compare_topology
from tests.roots import straight

ERROR = Metric(key="ball/volume_error", value=-0.010, unit="1", direction="zero", abs_tol=0.002)
IOU = Metric(key="ball/iou", value=0.90, unit="1", direction="up", abs_tol=0.01)
WALL = Metric(key="ball/wall", value=10.0, unit="s", direction="down", rel_tol=0.5)
RUN = [ERROR, IOU, WALL]


@pytest.fixture
def baseline(tmp_path: Path) -> gate.Baseline:
    gate.write_baseline(tmp_path / "baseline.json", RUN, about={"command": "test"})
    return gate.read_baseline(tmp_path / "baseline.json")


def verdicts(metrics, baseline, **crashed):
    return {finding.key: finding.verdict for finding in gate.compare(metrics, baseline, crashed=crashed)}


def test_the_same_run_passes(baseline):
    findings = gate.compare(RUN, baseline)
    assert gate.all_pass(findings)
    assert len(findings) == 3
    assert "the gate is open" in gate.table(findings)


CHANGES = {
    "error grows on its own side": (ERROR, -0.013, "WORSE"),
    "error changes its sign only": (ERROR, 0.010, "same"),
    "error shrinks": (ERROR, 0.001, "better"),
    "iou falls": (IOU, 0.88, "WORSE"),
    "time doubles": (WALL, 20.0, "WORSE"),
    "time grows by a third": (WALL, 13.3, "same"),
    "not a number": (IOU, math.nan, "NOT A NUMBER"),
    "infinite, though larger is better": (IOU, math.inf, "NOT A NUMBER"),
}


@pytest.mark.parametrize("name", CHANGES)
def test_a_change_is_judged_by_its_direction(baseline, name):
    metric, value, verdict = CHANGES[name]
    changed = [replace(old, value=value) if old is metric else old for old in RUN]
    assert verdicts(changed, baseline)[metric.key] == verdict
    assert gate.all_pass(gate.compare(changed, baseline)) == (verdict in ("same", "better"))


def test_a_crashed_incomplete_repeated_or_empty_run_fails(baseline, tmp_path):
    findings = gate.compare(RUN[:2], baseline)
    assert not gate.all_pass(findings)
    assert "MISSING" in gate.table(findings)
    assert "ball/wall" in gate.table(findings)
    extra = replace(IOU, key="ball/new")
    assert verdicts([*RUN, extra], baseline)["ball/new"] == "UNKNOWN"
    crashed = gate.compare(RUN, baseline, crashed={"ball": "Traceback\nZeroDivisionError: division by zero\n"})
    assert not gate.all_pass(crashed)
    assert "division by zero" in gate.table(crashed)
    for run in ([*RUN, extra], [ERROR, IOU, replace(WALL, unit="min")], [*RUN, IOU], []):
        assert not gate.all_pass(gate.compare(run, baseline))
    (tmp_path / "empty.json").write_text(json.dumps({"schema_version": 1, "metrics": {}}))
    assert not gate.all_pass(gate.compare([], gate.read_baseline(tmp_path / "empty.json")))
    assert not gate.all_pass([])


def test_a_failed_run_never_becomes_the_baseline(tmp_path):
    path = tmp_path / "baseline.json"
    gate.write_baseline(path, RUN, about={})
    before = path.read_bytes()
    for bad in ([], [ERROR, replace(IOU, value=math.nan)]):
        with pytest.raises(UserError, match=r"baseline\.json"):
            gate.write_baseline(path, bad, about={})
    assert path.read_bytes() == before


@pytest.mark.parametrize(
    "content",
    [None, "{", "[]", '{"schema_version": 7, "metrics": {}}', '{"schema_version": 1, "metrics": {"a": 3}}', '{"schema_version": 1}'],
)
def test_a_baseline_that_cannot_be_read_is_named(tmp_path, content):
    if content is not None:
        (tmp_path / "baseline.json").write_text(content)
    with pytest.raises(UserError, match=r"baseline\.json.*update"):
        gate.read_baseline(tmp_path / "baseline.json")


def test_a_missed_target_shuts_the_gate_whatever_the_baseline() -> None:
    key = "ladder/printed_8ml/clean/volume_worst"
    metric = Metric(key=key, value=0.03, unit="1", direction="down", abs_tol=0.01)
    baseline = gate.Baseline(path=Path("baseline.json"), values={key: 0.03}, units={key: "1"})
    findings = gate.compare([metric], baseline, crashed={})
    assert [finding.verdict for finding in findings] == ["MISSED"]
    assert not gate.all_pass(findings)
    share = TARGETS["ladder/all/clean/interval_holds"]
    assert [share.reached(value) for value in (0.84, 0.85, math.nan)] == [False, True, False]


CASE = Case(pictures=Pictures(scene="radish_day05a"))


lateral = partial(straight, mm=0.3, count=81, order=1, parent=0)
MAIN = straight((0, 0, -20), (0, 0, -100), 0.8, count=81)
LATERALS = [lateral((0, 0, z), (40, 0, z - 20)) for z in range(-90, -20, 10)]
CROSSING = [lateral((0, 0, -60), (30, 0, -36)), *(lateral((0, 0, z), (0, 6, z)) for z in range(-96, -30, 6))]
ROOTS = (MAIN, *LATERALS, *CROSSING)


def measured(found, record_of):
    score = record_of(CASE)["score"] | {"roots": asdict(compare_roots(found, ROOTS)), "topology": asdict(compare_topology(found, ROOTS))}
    return accuracy.metrics(CASE, {"score": score})


@pytest.mark.parametrize("fault", tree_faults.FAULTS)
def test_each_fault_shuts_the_gate_and_leaves_the_tree_whole(fault, record_of, tmp_path):
    faulty = tree_faults.apply(fault, ROOTS)
    assert all(-1 <= root.parent < len(faulty) and len(root.points_mm) == len(root.diameters_mm) for root in faulty)
    gate.write_baseline(tmp_path / "b.json", measured(ROOTS, record_of), about={})
    baseline = gate.read_baseline(tmp_path / "b.json")
    assert gate.all_pass(gate.compare(measured(ROOTS, record_of), baseline))
    assert not gate.all_pass(gate.compare(measured(faulty, record_of), baseline))


def test_faults_have_the_stated_size():
    whole, longest = length_mm(ROOTS), len(ROOTS)
    ghost = tree_faults.add_ghost(ROOTS)[-1]
    assert length_mm([ghost]) == pytest.approx(tree_faults.GHOST_MM, abs=0.6)
    assert length_mm(tree_faults.swap_continuations(ROOTS)) == pytest.approx(whole, abs=2 * tree_faults.CROSSING_MM)
    assert whole - length_mm(tree_faults.lose_tips(ROOTS)) == pytest.approx(2.0 * (longest - 1))
    shortest = 6.0  # of which the last one removed is at most one
    assert 0.05 * whole <= whole - length_mm(tree_faults.lose_length(ROOTS)) <= 0.05 * whole + shortest
