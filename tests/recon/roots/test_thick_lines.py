"""Lines of what is thick: no wiggles, and laterals count from where they leave what has swollen about them."""

import numpy as np
import pytest

from rhizotwin.recon.roots.thick_lines import BURIED_MM, calmed, emerged
from rhizotwin.scenes import polyline
from rhizotwin.scenes.rsml import Root


def straight(begin: list[float], end: list[float], diameter_mm: float, parent: int = 0) -> Root:
    points = np.linspace(begin, end, 41)
    return Root(points_mm=points, diameters_mm=np.full(41, diameter_mm), order=int(parent >= 0), parent=parent)


TAPROOT = straight([0.0, 0.0, 0.0], [0.0, 0.0, -40.0], 12.0, parent=-1)


def test_a_lateral_of_a_storage_root_begins_near_its_skin() -> None:
    lateral = straight([0.0, 0.0, -20.0], [30.0, 0.0, -20.0], 0.6)
    _, found = emerged([TAPROOT, lateral])
    assert found.points_mm[0] == pytest.approx([6.0 - BURIED_MM, 0.0, -20.0], abs=0.05)
    assert found.points_mm[-1] == pytest.approx(lateral.points_mm[-1])
    assert polyline.length_mm(found.points_mm) == pytest.approx(25.0, abs=0.05)
    assert len(found.diameters_mm) == len(found.points_mm)


def test_a_detour_within_it_does_not_count() -> None:
    inside = np.array([[0.0, 0.0, -30.0], [0.0, 0.0, -10.0], [2.0, 0.0, -12.0]])
    outside = np.linspace([4.0, 0.0, -14.0], [30.0, 0.0, -14.0], 53)
    points = np.concatenate([inside, outside])
    _, found = emerged([TAPROOT, Root(points_mm=points, diameters_mm=np.full(len(points), 0.6), order=1, parent=0)])
    assert polyline.length_mm(found.points_mm) == pytest.approx(25.0, abs=0.05)


def test_laterals_of_laterals_leave_the_storage_root_too() -> None:
    first = straight([0.0, 0.0, -20.0], [30.0, 0.0, -20.0], 0.6)
    second = straight([1.5, 0.0, -20.0], [1.5, 30.0, -20.0], 0.5, parent=1)
    found = emerged([TAPROOT, first, second])
    assert np.hypot(*found[2].points_mm[0, :2]) == pytest.approx(6.0 - BURIED_MM, abs=0.05)
    assert found[2].parent == 1


@pytest.mark.parametrize("diameter_mm", [0.6, 4.0])
def test_where_nothing_has_swollen_laterals_begin_on_the_axis(diameter_mm: float) -> None:
    parent = straight([0.0, 0.0, 0.0], [0.0, 0.0, -40.0], 1.9 if diameter_mm < 1.0 else 12.0, parent=-1)
    lateral = straight([0.0, 0.0, -20.0], [30.0, 0.0, -20.0], diameter_mm)
    assert emerged([parent, lateral]) == (parent, lateral)


def test_a_root_that_never_comes_out_stays() -> None:
    lateral = straight([0.0, 0.0, -20.0], [3.0, 0.0, -20.0], 0.6)
    assert emerged([TAPROOT, lateral]) == (TAPROOT, lateral)


def test_a_tip_that_goes_back_into_it_stays() -> None:
    points = np.array([[0.0, 0.0, -10.0], [20.0, 0.0, -10.0], [20.0, 0.0, -20.0], [3.0, 0.0, -20.0]])
    _, found = emerged([TAPROOT, Root(points_mm=points, diameters_mm=np.full(4, 0.6), order=1, parent=0)])
    assert found.points_mm[-1] == pytest.approx(points[-1])


def test_a_line_that_wanders_within_an_organ_is_calmed() -> None:
    rng = np.random.default_rng(1)
    line = np.concatenate([rng.normal(0.0, 0.2, (40, 3)), np.linspace([0.0, 0.0, 0.0], [0.0, 0.0, -40.0], 70)])
    calm = calmed(line, np.full(len(line), 8.0), np.ones(len(line), bool))
    assert polyline.length_mm(line) > 50.0
    assert polyline.length_mm(calm) == pytest.approx(40.0, abs=3.0)
    assert calm[[0, -1]] == pytest.approx(line[[0, -1]])


def test_straight_lines_and_fitted_nodes_stay() -> None:
    straight_line = np.linspace([0.0, 0.0, 0.0], [3.0, 4.0, 0.0], 9)
    assert calmed(straight_line, np.full(9, 2.0), np.ones(9, bool)) == pytest.approx(straight_line)
    bent = np.cumsum(np.random.default_rng(2).normal(size=(9, 3)), axis=0)
    assert calmed(bent, np.full(9, 2.0), np.zeros(9, bool)) == pytest.approx(bent)


def test_a_bend_is_hardly_cut() -> None:
    turn = np.linspace(0.0, np.pi, 60)
    bend = 10.0 * np.stack([np.cos(turn), np.sin(turn), 0.0 * turn], axis=1)
    calm = calmed(bend, np.full(60, 2.0), np.ones(60, bool))
    assert polyline.length_mm(calm) == pytest.approx(polyline.length_mm(bend), rel=0.003)
