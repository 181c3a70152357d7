"""The top of a taproot behind the net pot, extrapolated from what is seen below."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from rhizotwin.recon.hull.carve import Water
from rhizotwin.recon.hull.leaves import Grid
from rhizotwin.recon.tubes import tubes
from rhizotwin.recon.uncertainty import hidden_top
from rhizotwin.recon.uncertainty.overlap import find_overlaps, overlap_term
from rhizotwin.recon.uncertainty.wall_contact import wall_contact
from tests.recon.hull.blocks import block, everything
from tests.recon.strings import TRUNK, at_rest, line, root, strung

GAP_MM = 4.0


def hidden(end_mm: tuple[float, float, float], diameters: tuple[float, float] = (0.3, 0.3), gap_mm: float = GAP_MM):
    return hidden_top.estimate_hidden([root((0.0, 0.0, -12.0), end_mm, diameters=diameters)], [gap_mm])


@pytest.mark.parametrize("lean_mm", [0.0, 30.0])
def test_a_cylinder_goes_on_as_it_begins(lean_mm: float) -> None:
    found = hidden((lean_mm, 0.0, -52.0), (2.0, 2.0))
    length_mm = 4.0 * np.hypot(lean_mm, 40.0) / 40.0
    assert found.length_mm == pytest.approx(length_mm)
    assert found.volume_mm3 == pytest.approx(np.pi * length_mm)
    assert found.interval_mm3 == pytest.approx((found.volume_mm3, found.volume_mm3))
    assert "height_mm = 10" in found.warning(is_added=False)


def test_a_cone_has_an_interval_that_holds_what_it_has() -> None:
    found = hidden((0.0, 0.0, -52.0), (2.0, 1.0))
    true_mm3 = np.pi / 3.0 * 4.0 * (1.0 + 1.05 + 1.05**2)
    low_mm3, high_mm3 = found.interval_mm3
    assert low_mm3 < true_mm3 < high_mm3
    assert (found.term.less_mm3, found.term.more_mm3) == pytest.approx((found.volume_mm3 - low_mm3, high_mm3 - found.volume_mm3))


def test_laterals_overlap_in_the_common_part_of_two_cylinders() -> None:
    """Laterals of 1 mm radius leave the same stem; the gap is a part of a block, within 2 mm of their common part."""
    apart_mm = 1.5
    laterals = [line((0.0, 0.0, z), (16.0, 0.0, z)) for z in (-30.0, -30.0 - apart_mm)]
    system = at_rest(strung(TRUNK, *laterals, radius_mm=1.0), px_a_mm=4.0)
    place_mm, diameter_mm = find_overlaps(system)
    x, y, z = place_mm.T
    assert max(np.hypot(y, z - axis_mm).max() for axis_mm in (-30.0, -30.0 - apart_mm)) < 1.05
    assert x.min() == pytest.approx(1.0, abs=0.5)  # the stem contains their first millimetre
    assert (diameter_mm == 2.0).all()
    filled = everything(Grid(np.array([3.0, -4.0, -36.0]), 0.25, 1, (16, 16, 20)))
    every = 0.05 * np.argwhere(np.ones((300, 40, 80))) + [1.0, -1.0, -33.0]
    common = every[(np.hypot(every[:, 1], every[:, 2] + 30.0) < 1.0) & (np.hypot(every[:, 1], every[:, 2] + 30.0 + apart_mm) < 1.0)]
    near = cKDTree(common).query(filled.middles_mm)[0] < 2.0
    assert overlap_term(system, filled, filled.select(slice(0))).more_mm3 == pytest.approx(near.sum() * 0.25**3, rel=0.08)
    assert overlap_term(system, filled, filled).more_mm3 == 0.0


def test_laterals_in_their_parent_and_thin_roots_are_left_out() -> None:
    whorl = [line((0.0, 0.0, -40.0), (20.0 * np.cos(a), 20.0 * np.sin(a), -40.0)) for a in np.deg2rad([0, 90, 180, 270])]
    radii = [np.full(len(TRUNK), 2.0), *(np.full(len(path), 1.0) for path in whorl)]
    thin = strung(TRUNK, *(line((0.0, 0.0, z), (30.0, 0.0, z)) for z in (-30.0, -30.2)), radius_mm=0.2)
    assert [len(find_overlaps(at_rest(one, px_a_mm=4.0))[0]) for one in (tubes.place_nodes([TRUNK, *whorl], radii), thin)] == [0, 0]


CELL_MM = 0.25
WATER = Water(20.0, 0.0, -20.0)
Lattice = tuple[NDArray[np.int32], NDArray[np.float64]]


@pytest.fixture(scope="module")
def lattice() -> Lattice:
    """Nodes (N, 3) about the wall at x = 20, and their middles in mm."""
    grid = WATER.grid(CELL_MM)
    low = np.floor((np.array([8.0, -8.0, -18.0]) - grid.origin_mm) / CELL_MM).astype(np.int32)
    index = low + np.array(list(np.ndindex(50, 64, 64)), np.int32)
    middle = np.asarray(grid.origin_mm) + (index + 0.5) * CELL_MM
    wet = np.hypot(middle[:, 0], middle[:, 1]) < WATER.radius_mm
    return index[wet], middle[wet]


def test_a_slab_on_the_wall_may_be_nothing(lattice: Lattice) -> None:
    index, middle = lattice
    slab = (np.hypot(middle[:, 0], middle[:, 1]) > 17.0) & (np.abs(middle[:, 1]) < 5.0) & (np.abs(middle[:, 2] + 10.0) < 4.0)
    term = wall_contact(block(WATER.grid(CELL_MM), index[slab]), WATER)
    area_mm2 = 2.0 * 20.0 * np.arcsin(5.0 / 20.0) * 8.0
    # of a volume no larger than the wedge behind its area, all of it
    assert term.less_mm3 == pytest.approx(slab.sum() * CELL_MM**3)
    assert term.less_mm3 < 0.5 * area_mm2 * 20.0
    assert term.more_mm3 == 0.0


def test_a_small_label_may_hide_the_wedge_behind_it(lattice: Lattice) -> None:
    index, middle = lattice
    label = (np.abs(middle[:, 1]) < 1.0) & (np.abs(middle[:, 2] + 10.0) < 1.0)
    root = np.hypot(middle[:, 1], middle[:, 2] + 10.0) < 3.0
    term = wall_contact(block(WATER.grid(CELL_MM), index[label | (root & (middle[:, 0] < 17.0))]), WATER)
    assert term.less_mm3 == pytest.approx(0.5 * 4.0 * 20.0, rel=0.1)


def test_what_is_round_or_stays_off_the_wall_is_none(lattice: Lattice) -> None:
    index, middle = lattice
    roots = [np.hypot(middle[:, 0] - (20.0 - radius_mm), middle[:, 1]) < radius_mm for radius_mm in (1.5, 6.0)]
    others = np.linalg.norm(middle - [15.0, 0.0, -10.0], axis=1) < 5.0, np.abs(middle[:, 0] - 12.0) < 2.0, middle[:, 0] > 99.0
    shapes = [block(WATER.grid(CELL_MM), index[inside]) for inside in (*roots, *others)]
    share = [wall_contact(shape, WATER).less_mm3 / max(shape.volume_mm3(), 1.0) for shape in shapes]
    assert max(share[:2]) < 0.02
    assert share[2:] == [0.0] * 3
