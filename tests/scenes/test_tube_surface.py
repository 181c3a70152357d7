"""The outside of tubes whose area is known in closed form."""

import numpy as np
import pytest

from rhizotwin.scenes.rsml import Root
from rhizotwin.scenes.tube_surface import exposed_area_mm2, stations


def tube(start, end, radius_mm) -> Root:
    return Root(points_mm=np.array([start, end], float), diameters_mm=np.full(2, 2.0 * radius_mm), order=0, parent=-1)


def test_one_tube_has_the_area_of_a_cylinder():
    root = tube([1.0, 2.0, 3.0], [4.0, 6.0, -9.0], 0.2)
    assert exposed_area_mm2(stations([root])).sum() == pytest.approx(2.0 * np.pi * 0.2 * 13.0)


def test_a_lateral_is_hidden_as_far_as_it_runs_inside_its_parent():
    parent, lateral = tube([0.0, 0.0, -30.0], [0.0, 0.0, 30.0], 3.0), tube([0.0, 0.0, 0.0], [13.0, 0.0, 0.0], 0.1)
    pieces = stations([parent, lateral])
    area = exposed_area_mm2(pieces)
    assert area[pieces.root == 1].sum() == pytest.approx(2.0 * np.pi * 0.1 * 10.0, rel=0.02)  # the pieces' length is the error
    assert area[pieces.root == 0].sum() == pytest.approx(2.0 * np.pi * 3.0 * 60.0, rel=1e-3)


def test_of_two_in_one_place_nothing_is_outside_but_the_larger():
    same = [tube([0.0, 0.0, 0.0], [0.0, 0.0, -10.0], radius) for radius in (0.2, 0.3)]
    assert exposed_area_mm2(stations(same)).sum() == pytest.approx(2.0 * np.pi * 0.3 * 10.0)
