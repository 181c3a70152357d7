"""Lines of what is thick: no wiggles, and laterals count from where they leave what has swollen about them."""

import numpy as np
import pytest

from rhizotwin.recon.roots.thick_lines import BURIED_MM, calmed, emerged
from rhizotwin.scenes import polyline
from rhizotwin.scenes.rsml import Root
from tests.recon.strings import line


def root(points: np.ndarray, diameter_mm: float, parent: int = 0) -> Root:
    return Root(points_mm=points, diameters_mm=np.full(len(points), diameter_mm), order=int(parent >= 0), parent=parent)


TAPROOT = root(line((0.0, 0.0, 0.0), (0.0, 0.0, -40.0), step=1.0), 12.0, parent=-1)
LATERAL = root(line((0.0, 0.0, -20.0), (30.0, 0.0, -20.0), step=0.75), 0.6)


def test_a_lateral_of_a_storage_root_begins_near_its_skin() -> None:
    second = root(line((1.5, 0.0, -20.0), (1.5, 30.0, -20.0), step=0.75), 0.5, parent=1)
    _, found, of_lateral = emerged([TAPROOT, LATERAL, second])
    assert found.points_mm[0] == pytest.approx([6.0 - BURIED_MM, 0.0, -20.0], abs=0.05)
    assert found.points_mm[-1] == pytest.approx(LATERAL.points_mm[-1])
    assert polyline.length_mm(found.points_mm) == pytest.approx(25.0, abs=0.05)
    assert len(found.diameters_mm) == len(found.points_mm)
    assert np.hypot(*of_lateral.points_mm[0, :2]) == pytest.approx(6.0 - BURIED_MM, abs=0.05), "laterals of laterals too"
    assert of_lateral.parent == 1


@pytest.mark.parametrize(
    ("parent", "lateral"),
    [
        (root(TAPROOT.points_mm, 1.9, parent=-1), LATERAL),
        (TAPROOT, root(LATERAL.points_mm, 4.0)),
        (TAPROOT, root(LATERAL.points_mm[:5], 0.6)),
    ],
    ids=["a thin parent", "a thick lateral", "a root that never comes out"],
)
def test_where_nothing_has_swollen_laterals_begin_on_the_axis(parent: Root, lateral: Root) -> None:
    assert emerged([parent, lateral]) == (parent, lateral)


def test_a_line_that_wanders_within_an_organ_is_calmed() -> None:
    wandering = np.concatenate([np.random.default_rng(1).normal(0.0, 0.2, (40, 3)), np.linspace([0.0, 0.0, 0.0], [0.0, 0.0, -40.0], 70)])
    calm = calmed(wandering, np.full(len(wandering), 8.0), np.ones(len(wandering), bool))
    assert polyline.length_mm(wandering) > 50.0
    assert polyline.length_mm(calm) == pytest.approx(40.0, abs=3.0)
    assert calm[[0, -1]] == pytest.approx(wandering[[0, -1]])


def test_straight_lines_bends_and_fitted_nodes_stay() -> None:
    straight = np.linspace([0.0, 0.0, 0.0], [3.0, 4.0, 0.0], 9)
    assert calmed(straight, np.full(9, 2.0), np.ones(9, bool)) == pytest.approx(straight)
    fitted = np.cumsum(np.random.default_rng(2).normal(size=(9, 3)), axis=0)
    assert calmed(fitted, np.full(9, 2.0), np.zeros(9, bool)) == pytest.approx(fitted)
    turn = np.linspace(0.0, np.pi, 60)
    bend = 10.0 * np.stack([np.cos(turn), np.sin(turn), 0.0 * turn], axis=1)
    calm = calmed(bend, np.full(60, 2.0), np.ones(60, bool))
    assert polyline.length_mm(calm) == pytest.approx(polyline.length_mm(bend), rel=0.003)
