"""Frames, lines of points, lenses and tubes against their closed forms."""

import math
from functools import partial

import numpy as np
import pytest

from rhizotwin.scenes import frames, polyline
from rhizotwin.scenes.lens import fold_r2
from rhizotwin.scenes.tube_surface import exposed_area_mm2, stations
from tests.roots import straight

CORNER = np.array([[0.0, 0.0, 0.0], [3.0, 4.0, 0.0], [3.0, 4.0, 2.0]])


def test_a_twist_turns_each_point_by_its_share() -> None:
    points, share = np.random.default_rng(0).normal(0.0, 30.0, (50, 3)), np.linspace(0.0, 1.0, 50)
    turns = [frames.rotation_z(np.deg2rad(30.0) * part) for part in share]
    expected = [frames.apply(turn, point) for turn, point in zip(turns, points, strict=True)]
    np.testing.assert_allclose(frames.twist(points, share, 30.0), expected, atol=1e-12)


def test_a_corner_is_as_long_as_its_legs() -> None:
    assert polyline.steps_mm(CORNER).tolist() == [5.0, 2.0]
    assert polyline.length_mm(CORNER) == 7.0
    assert polyline.arc_length_mm(CORNER).tolist() == [0.0, 5.0, 7.0]
    assert polyline.length_mm(CORNER[:1]) == 0.0
    np.testing.assert_allclose(polyline.unit_vectors(CORNER), [[0.0, 0.0, 0.0], [0.6, 0.8, 0.0], CORNER[2] / 29.0**0.5])
    found = polyline.interpolate(CORNER, polyline.arc_length_mm(CORNER), np.array([-1.0, 2.5, 6.0, 9.0]))
    assert np.allclose(found, [[0.0, 0.0, 0.0], [1.5, 2.0, 0.0], [3.0, 4.0, 1.0], [3.0, 4.0, 2.0]])


@pytest.mark.parametrize(
    ("distortion", "expected"),
    [
        ((0.3, 0.1, 0.0, 0.0, 0.0), math.inf),
        ((-0.5, 0.0, 0.0, 0.0, 0.0), 2.0 / 3.0),  # 1 - 1.5 r^2
        ((-0.5, 0.1, 0.0, 0.0, 0.0), 1.0),  # (1 - r^2) (1 - r^2 / 2)
        ((0.0, 0.0, 0.5, 0.5, -1.0 / 7.0), 1.0),  # 1 - r^6; the tangential terms have no influence
    ],
    ids=["pincushion", "barrel", "two folds", "third term"],
)
def test_a_lens_folds_where_the_derivative_is_first_zero(distortion: tuple[float, ...], expected: float) -> None:
    assert fold_r2(distortion) == pytest.approx(expected)


tube = partial(straight, count=2)


def test_a_lateral_is_hidden_as_far_as_it_runs_inside_its_parent():
    alone = stations([tube([1.0, 2.0, 3.0], [4.0, 6.0, -9.0], 0.4)])
    assert exposed_area_mm2(alone).sum() == pytest.approx(2.0 * np.pi * 0.2 * 13.0)
    parent, lateral = tube([0.0, 0.0, -30.0], [0.0, 0.0, 30.0], 6.0), tube([0.0, 0.0, 0.0], [13.0, 0.0, 0.0], 0.2)
    pieces = stations([parent, lateral])
    area = exposed_area_mm2(pieces)
    assert area[pieces.root == 1].sum() == pytest.approx(2.0 * np.pi * 0.1 * 10.0, rel=0.02)  # the pieces' length is the error
    assert area[pieces.root == 0].sum() == pytest.approx(2.0 * np.pi * 3.0 * 60.0, rel=1e-3)
    same = stations([tube([0.0, 0.0, 0.0], [0.0, 0.0, -10.0], mm) for mm in (0.4, 0.6)])
    assert exposed_area_mm2(same).sum() == pytest.approx(2.0 * np.pi * 0.3 * 10.0)  # in one place only the larger is outside
