"""Fold of the lens distortion, for polynomials whose derivative has known roots."""

import math

import pytest

from rhizotwin.scenes.lens import fold_r2


@pytest.mark.parametrize(
    ("distortion", "expected"),
    [
        ((0.0, 0.0, 0.0, 0.0, 0.0), math.inf),
        ((0.3, 0.1, 0.0, 0.0, 0.0), math.inf),
        ((-0.5, 0.0, 0.0, 0.0, 0.0), 2.0 / 3.0),  # 1 - 1.5 r^2
        ((-0.5, 0.1, 0.0, 0.0, 0.0), 1.0),  # (1 - r^2) (1 - r^2 / 2)
        ((0.0, 0.0, 0.5, 0.5, -1.0 / 7.0), 1.0),  # 1 - r^6; the tangential terms have no influence
    ],
    ids=["none", "pincushion", "barrel", "two folds", "third term"],
)
def test_the_fold_is_the_first_radius_at_which_the_derivative_is_zero(distortion: tuple[float, ...], expected: float) -> None:
    assert fold_r2(distortion) == pytest.approx(expected)
