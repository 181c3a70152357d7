"""Lines of points against their closed form."""

import numpy as np
import pytest

from rhizotwin.scenes import polyline

CORNER = np.array([[0.0, 0.0, 0.0], [3.0, 4.0, 0.0], [3.0, 4.0, 2.0]])


def test_a_corner_is_as_long_as_its_legs() -> None:
    assert polyline.steps_mm(CORNER).tolist() == [5.0, 2.0]
    assert polyline.length_mm(CORNER) == 7.0
    assert polyline.arc_length_mm(CORNER).tolist() == [0.0, 5.0, 7.0]
    assert polyline.length_mm(CORNER[:1]) == 0.0


def test_unit_vectors_point_the_same_way() -> None:
    np.testing.assert_allclose(polyline.unit_vectors(CORNER), [[0.0, 0.0, 0.0], [0.6, 0.8, 0.0], np.array([3.0, 4.0, 2.0]) / 29.0**0.5])


def test_places_between_lie_on_the_legs() -> None:
    way = polyline.arc_length_mm(CORNER)
    found = polyline.interpolate(CORNER, way, np.array([-1.0, 2.5, 6.0, 9.0]))
    assert np.allclose(found, [[0.0, 0.0, 0.0], [1.5, 2.0, 0.0], [3.0, 4.0, 1.0], [3.0, 4.0, 2.0]])


@pytest.mark.parametrize(("step_mm", "expected"), [(1.0, [0.5, 1.5, 2.5]), (0.9, [0.5, 1.5, 2.5]), (100.0, [1.5])])
def test_middles_are_of_equal_pieces(step_mm: float, expected: list[float]) -> None:
    way = polyline.arc_length_mm(np.array([[0.0, 0.0, 0.0], [0.0, 1.0, 0.0], [2.0, 1.0, 0.0]]))
    assert polyline.middles(way, step_mm) == pytest.approx(expected)
