"""Centre lines of a hull: solids that thinning deletes keep a point, whatever is beside them."""

import numpy as np
import pytest

from rhizotwin.recon.hull.centre_lines import centre_lines
from rhizotwin.recon.hull.leaves import Grid
from tests.recon.hull.blocks import block

GRID = Grid(origin_mm=np.zeros(3), size_mm=0.5, coarse_shape=(1, 1, 1), levels=6)


@pytest.mark.parametrize(("shape", "is_round"), [((8, 9, 8), True), ((8, 8, 12), False), ((8, 12, 11), True)])
def test_a_solid_beside_a_speck_has_its_deepest_point(shape: tuple[int, int, int], is_round: bool) -> None:
    """Thinning deletes the solid on a lattice, and the speck is too near for the curves of the shifted one."""
    middle, index = np.array(shape) / 2.0, np.argwhere(np.ones(shape, bool))
    if is_round:
        index = index[(((index + 0.5 - middle) / middle) ** 2).sum(axis=1) < 1.0]
    speck = np.array([(shape[0] + step, shape[1] // 2, shape[2] // 2) for step in (3, 4)])
    points = centre_lines(block(GRID, np.concatenate([index, speck]) + 4))
    assert np.linalg.norm(points - (4.0 + middle) * 0.5, axis=1).min() < 0.5 * 0.5 * min(shape)
    assert (points[:, 0] > 0.5 * (4 + shape[0])).any()
