"""Laterals on thick roots count from where they leave what has swollen about them."""

import numpy as np
import pytest

from rhizotwin.recon.roots.thick_lines import BURIED_MM, trim_buried
from rhizotwin.scenes import polyline
from rhizotwin.scenes.rsml import Root
from tests.recon.strings import line


def root(points: np.ndarray, diameter_mm: float, parent: int = 0) -> Root:
    return Root(points_mm=points, diameters_mm=np.full(len(points), diameter_mm), order=int(parent >= 0), parent=parent)


TAPROOT = root(line((0.0, 0.0, 0.0), (0.0, 0.0, -40.0), step=1.0), 12.0, parent=-1)
LATERAL = root(line((0.0, 0.0, -20.0), (30.0, 0.0, -20.0), step=0.75), 0.6)


def test_a_lateral_of_a_storage_root_begins_near_its_skin() -> None:
    second = root(line((1.5, 0.0, -20.0), (1.5, 30.0, -20.0), step=0.75), 0.5, parent=1)
    _, found, of_lateral = trim_buried([TAPROOT, LATERAL, second])
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
    assert trim_buried([parent, lateral]) == (parent, lateral)
