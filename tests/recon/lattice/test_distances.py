"""Exact distances in pictures and sets of cells, against distances to all samples."""

import numpy as np
import pytest
from scipy import ndimage

from rhizotwin.recon.lattice import distances


@pytest.mark.parametrize(
    ("shape", "sigma", "share"), [((40, 50), 1.0, 0.3), ((70, 33), 3.0, 0.7), ((25, 60), 0.01, 0.5), ((30, 30), 8.0, 0.02)]
)
def test_distance_to_a_level(shape: tuple[int, int], sigma: float, share: float) -> None:
    smooth = ndimage.gaussian_filter(np.random.default_rng(3).normal(size=shape), sigma).astype(np.float32)
    value = smooth - np.quantile(smooth, share).astype(np.float32)
    found, inside, size = distances.level_distance(value), value > 0, np.abs(value)
    np.testing.assert_array_equal(found > 0, inside)
    inverse_2 = np.zeros(shape)
    for axis in (0, 1):
        nearest = np.full(shape, np.inf)
        for side in (-1, 1):
            other = np.roll(value, side, axis)
            crosses = (other > 0) != inside
            crosses[(slice(None),) * axis + (0 if side == 1 else -1,)] = False
            nearest = np.minimum(nearest, np.where(crosses, size / (size + np.abs(other)), np.inf))
        inverse_2 += np.maximum(nearest, 1e-3) ** -2.0
    beside = inverse_2 > 0
    near = np.where(beside, 1.0 / np.sqrt(np.maximum(inverse_2, 1e-12)), 0.0)
    np.testing.assert_allclose(np.abs(found)[beside], near[beside], rtol=1e-5)
    columns_first = np.argwhere(np.ones(shape[::-1], bool))[:, ::-1]
    expected = []
    for at in np.argwhere(~beside):
        others = columns_first[inside[tuple(columns_first.T)] != inside[tuple(at)]]
        away = np.linalg.norm(others - at, axis=1)
        expected.append(max(away.min() - near[tuple(others[away.argmin()])], 0.5))
    np.testing.assert_allclose(np.abs(found)[~beside], expected, atol=1e-4)


@pytest.mark.parametrize("value", [-2.0, 3.0])
def test_a_level_that_is_not_crossed_is_far(value: float) -> None:
    assert (distances.level_distance(np.full((5, 6), value, np.float32)) * value > 1e3).all()


@pytest.mark.parametrize("seed", range(3))
def test_depth_is_the_distance_to_the_nearest_empty_cell(seed: int) -> None:
    rng = np.random.default_rng(seed)
    smooth = ndimage.gaussian_filter(rng.normal(size=(16, 17, 30)), 1.3)
    full = np.pad(smooth > np.quantile(smooth, 0.6), 1)
    index = rng.permutation(np.argwhere(full))
    np.testing.assert_allclose(distances.depth(index - (5, -3, 9)), ndimage.distance_transform_edt(full)[tuple(index.T)])
    assert len(distances.depth(index[:0])) == 0
