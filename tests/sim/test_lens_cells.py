"""Rays of a pixel and their places on the lens: defocus must not move pictures."""

import numpy as np
import pytest

from rhizotwin.sim.render import lens_cells


@pytest.mark.parametrize("side", [1, 3, 4, 5, 9])
def test_any_two_coordinates_of_pixel_and_lens_are_a_full_lattice(side: int) -> None:
    ray = np.arange(side * side)
    coordinates = (ray % side, ray // side, *lens_cells(side))
    for a in range(4):
        for b in range(a):
            assert len(set(zip(coordinates[a].tolist(), coordinates[b].tolist(), strict=True))) == side * side


@pytest.mark.parametrize("side", [2, 6, 8])
def test_where_there_is_no_such_array_the_whole_lens_is_still_used(side: int) -> None:
    column, row = lens_cells(side)
    assert len(set(zip(column.tolist(), row.tolist(), strict=True))) == side * side
