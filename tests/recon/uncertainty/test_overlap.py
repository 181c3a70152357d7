"""Overlap of thick roots, against the common part of two cylinders."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from rhizotwin.recon.hull.leaves import Grid, Leaves
from rhizotwin.recon.tubes import tubes
from rhizotwin.recon.uncertainty.overlap import find_overlaps, overlap_term
from tests.recon.strings import at_rest, line, strung

STEM = line((0.0, 0.0, -20.0), (0.0, 0.0, -50.0))


def whole(grid: Grid) -> Leaves:
    """Return leaves of the finest size that fill a grid."""
    index = np.argwhere(np.ones(np.array(grid.coarse_shape) * 2**grid.levels, bool)).astype(np.int32)
    return Leaves(grid, index, np.ones(len(index), np.int32), np.ones(len(index), np.float32))


@pytest.mark.parametrize("apart_mm", [1.0, 1.5])
def test_the_overlap_of_two_laterals_is_the_common_part_of_two_cylinders(apart_mm: float) -> None:
    """Laterals of 1 mm radius leave the same stem; the gap is a part of a block, within 2 mm of their common part."""
    laterals = [line((0.0, 0.0, z), (16.0, 0.0, z)) for z in (-30.0, -30.0 - apart_mm)]
    system = at_rest(strung(STEM, *laterals, radius_mm=1.0), px_a_mm=4.0)
    place_mm, diameter_mm = find_overlaps(system)
    x, y, z = place_mm.T
    for axis_mm in (-30.0, -30.0 - apart_mm):
        assert (np.hypot(y, z - axis_mm) < 1.05).all()
    assert x.min() == pytest.approx(1.0, abs=0.5)  # the stem contains their first millimetre
    assert (diameter_mm == 2.0).all()
    grid = Grid(np.array([3.0, -4.0, -36.0]), 0.25, 1, (16, 16, 20))
    block = whole(grid)
    every = 0.05 * np.argwhere(np.ones((300, 40, 80))) + [1.0, -1.0, -33.0]
    common = every[(np.hypot(every[:, 1], every[:, 2] + 30.0) < 1.0) & (np.hypot(every[:, 1], every[:, 2] + 30.0 + apart_mm) < 1.0)]
    near = cKDTree(common).query(block.middles_mm)[0] < 2.0
    none = block.select(slice(0))
    assert overlap_term(system, block, none).more_mm3 == pytest.approx(near.sum() * 0.25**3, rel=0.08)
    assert overlap_term(system, block, block).more_mm3 == 0.0


def test_laterals_inside_their_parent_do_not_overlap_it() -> None:
    whorl = [line((0.0, 0.0, -40.0), (20.0 * np.cos(a), 20.0 * np.sin(a), -40.0)) for a in np.deg2rad([0, 90, 180, 270])]
    radii = [np.full(len(STEM), 2.0), *(np.full(len(path), 1.0) for path in whorl)]
    roots = tubes.place_nodes([STEM, *whorl], radii)
    assert not len(find_overlaps(at_rest(roots, px_a_mm=4.0))[0])


def test_thin_roots_do_not_count() -> None:
    laterals = [line((0.0, 0.0, z), (30.0, 0.0, z)) for z in (-30.0, -30.2)]
    assert not len(find_overlaps(at_rest(strung(STEM, *laterals, radius_mm=0.2), px_a_mm=4.0))[0])
