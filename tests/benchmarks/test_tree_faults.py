"""Deliberate faults of a tree: each changes what its name says, and shuts the gate."""

from dataclasses import asdict

import numpy as np
import pytest

from benchmarks import accuracy, gate, tree_faults
from benchmarks.cases import Case, Pictures
from rhizotwin.scenes.rsml import Root, length_mm
from rhizotwin.scoring.score_roots import compare_roots
from rhizotwin.scoring.score_topology import compare_topology

CASE = Case(pictures=Pictures(scene="radish_day05a"))


def straight(start, end, *, parent, order=1, mm=0.3):
    return Root(points_mm=np.linspace(start, end, 81, dtype=float), diameters_mm=np.full(81, mm), order=order, parent=parent)


MAIN = straight((0, 0, -20), (0, 0, -100), parent=-1, order=0, mm=0.8)
LATERALS = [straight((0, 0, z), (40, 0, z - 20), parent=0) for z in range(-90, -20, 10)]
CROSSING = [straight((0, 0, -60), (30, 0, -36), parent=0), *(straight((0, 0, z), (0, 6, z), parent=0) for z in range(-96, -30, 6))]
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
