"""Rays of a pixel and their places on the lens: defocus must not move pictures."""

from itertools import combinations

import numpy as np

from rhizotwin.sim.render import lens_cells


def test_any_two_coordinates_of_pixel_and_lens_are_a_full_lattice() -> None:
    for side in (1, 3, 4, 5, 9):
        ray = np.arange(side * side)
        coordinates = np.array([ray % side, ray // side, *lens_cells(side)])
        for a, b in combinations(coordinates, 2):
            assert len(np.unique(a * side + b)) == side * side
