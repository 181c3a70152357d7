"""The volume after corrections is that of the remaining parts of the roots."""

from dataclasses import replace

import numpy as np
import pytest

from rhizotwin.corrections import log
from rhizotwin.corrections.session import Session
from tests.rhizotwin import plant as plants
from tests.rhizotwin.plant import Plant


def painted_mm3(*roots) -> float:
    leaves = plants.painted(tuple(replace(root, parent=-1) for root in roots))
    return float(leaves.occupancy.sum(dtype=np.float64)) * leaves.voxel_mm**3


@pytest.mark.parametrize("gone", [(1,), (2, 3)])
def test_volume_without_roots_is_that_of_the_others_painted_afresh(plant: Plant, gone: tuple[int, ...]):
    """Painting a plant evens what sampling puts too much into full voxels out among the others, laterals by some 2 % of their own."""
    session = Session(plant.result)
    session.do(log.edit("delete roots", roots=gone))
    left = painted_mm3(*(root for k, root in enumerate(plant.roots) if k not in gone))
    assert session.measure().volume_mm3 == pytest.approx(left, rel=2.5e-3)


def test_the_volume_that_two_roots_share_stays_with_the_one_that_is_left(plant: Plant):
    """The laterals begin inside the main root, whose volume it is: without the main root it is theirs."""
    session = Session(plant.result)
    session.do(log.edit("delete roots", roots=[0]))
    assert session.measure().volume_mm3 == pytest.approx(painted_mm3(*plant.roots[1:]), rel=3e-2)
    assert {line.parent for line in session.state.lines.values()} == {-1}
