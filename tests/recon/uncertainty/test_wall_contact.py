"""What lies flat on the wall is told from what is round and touches it."""

import numpy as np
import pytest
from numpy.typing import NDArray

from rhizotwin.recon.hull.carve import Water
from rhizotwin.recon.hull.leaves import Leaves
from rhizotwin.recon.uncertainty.wall_contact import wall_contact

CELL_MM = 0.25
WATER = Water(20.0, 0.0, -20.0)
Array = NDArray[np.float64]


def filled(inside: NDArray[np.bool_], index: NDArray[np.int32]) -> Leaves:
    index = index[inside]
    return Leaves(WATER.grid(CELL_MM), index, np.ones(len(index), np.int32), np.ones(len(index), np.float32))


@pytest.fixture(scope="module")
def lattice() -> tuple[NDArray[np.int32], Array]:
    """Nodes (N, 3) about the wall at x = 20, and their middles in mm."""
    grid = WATER.grid(CELL_MM)
    low = np.floor((np.array([8.0, -8.0, -18.0]) - grid.origin_mm) / CELL_MM).astype(np.int32)
    index = low + np.array(list(np.ndindex(50, 64, 64)), np.int32)
    middle = np.asarray(grid.origin_mm) + (index + 0.5) * CELL_MM
    wet = np.hypot(middle[:, 0], middle[:, 1]) < WATER.radius_mm
    return index[wet], middle[wet]


def test_a_slab_on_the_wall_may_be_nothing(lattice: tuple[NDArray[np.int32], Array]) -> None:
    index, middle = lattice
    slab = (np.hypot(middle[:, 0], middle[:, 1]) > 17.0) & (np.abs(middle[:, 1]) < 5.0) & (np.abs(middle[:, 2] + 10.0) < 4.0)
    term = wall_contact(filled(slab, index), WATER)
    area_mm2 = 2.0 * 20.0 * np.arcsin(5.0 / 20.0) * 8.0
    # of a volume no larger than the wedge behind its area, all of it
    assert term.less_mm3 == pytest.approx(slab.sum() * CELL_MM**3)
    assert term.less_mm3 < 0.5 * area_mm2 * 20.0
    assert term.more_mm3 == 0.0


def test_a_small_label_may_hide_the_wedge_behind_it(lattice: tuple[NDArray[np.int32], Array]) -> None:
    index, middle = lattice
    label = (np.abs(middle[:, 1]) < 1.0) & (np.abs(middle[:, 2] + 10.0) < 1.0)
    root = np.hypot(middle[:, 1], middle[:, 2] + 10.0) < 3.0
    term = wall_contact(filled(label | (root & (middle[:, 0] < 17.0)), index), WATER)
    assert term.less_mm3 == pytest.approx(0.5 * 4.0 * 20.0, rel=0.1)


def test_what_is_round_or_stays_off_the_wall_is_none(lattice: tuple[NDArray[np.int32], Array]) -> None:
    index, middle = lattice
    for radius_mm in (1.5, 6.0):
        root = filled(np.hypot(middle[:, 0] - (20.0 - radius_mm), middle[:, 1]) < radius_mm, index)
        assert wall_contact(root, WATER).less_mm3 < 0.02 * root.volume_mm3()
    ball, off, nothing = np.linalg.norm(middle - [15.0, 0.0, -10.0], axis=1) < 5.0, np.abs(middle[:, 0] - 12.0) < 2.0, middle[:, 0] > 99.0
    assert [wall_contact(filled(inside, index), WATER).less_mm3 for inside in (ball, off, nothing)] == [0.0] * 3
