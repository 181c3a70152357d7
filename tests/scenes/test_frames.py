"""Transforms between frames."""

import numpy as np

from rhizotwin.scenes import frames


def test_a_twist_turns_each_point_by_its_share() -> None:
    points = np.random.default_rng(0).normal(0.0, 30.0, (50, 3))
    share = np.linspace(0.0, 1.0, 50)
    found = frames.twist(points, share, 30.0)
    for point, part, moved in zip(points, share, found, strict=True):
        np.testing.assert_allclose(moved, frames.apply(frames.rotation_z(np.deg2rad(30.0) * part), point), atol=1e-12)
