"""The distance to a picture's level, where the inside is narrow and where it is wide, against every sample outside."""

import cv2
import numpy as np
import pytest

from rhizotwin.recon.coverage import level_distance


def blobs(seed: int, shape: tuple[int, int] = (70, 90)) -> np.ndarray:
    """Smooth noise: islands, holes, necks, and insides that touch the border."""
    noise = np.random.default_rng(seed).normal(size=shape).astype(np.float32)
    return np.asarray(cv2.GaussianBlur(noise, (0, 0), 4.0))


@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.parametrize("is_narrow", [True, False])
def test_inside_the_nearest_sample_outside_counts(seed: int, is_narrow: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(level_distance, "_LOOKS", 1e9 if is_narrow else 0.0)
    value = blobs(seed)
    found, inside = level_distance.level_distance(value), value > 0
    near = np.abs(np.where(level_distance._near(value, inside).reshape(value.shape) > 0, found, 0.0))
    outside = np.argwhere(~inside)
    deep = np.argwhere(inside & (near == 0))
    away = np.linalg.norm(deep[:, None] - outside, axis=2)
    nearest = away <= away.min(axis=1, keepdims=True) + 1e-9
    beyond = near[tuple(outside.T)]
    least = away.min(axis=1) - np.where(nearest, beyond, 0.0).max(axis=1)
    most = away.min(axis=1) - np.where(nearest, beyond, 9.0).min(axis=1)
    at = found[tuple(deep.T)]
    assert (at > np.maximum(least, 0.5) - 1e-3).all()
    assert (at < np.maximum(most, 0.5) + 1e-3).all()


def test_narrow_and_wide_insides_are_alike(monkeypatch: pytest.MonkeyPatch) -> None:
    """Both ways take the same of several samples as near."""
    value = blobs(3, (200, 260))
    narrow = level_distance.level_distance(value)
    monkeypatch.setattr(level_distance, "_LOOKS", 0.0)
    wide = level_distance.level_distance(value)
    np.testing.assert_allclose(narrow, wide, atol=1e-4)
