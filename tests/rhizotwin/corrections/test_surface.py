"""Surface of a corrected shape."""

import numpy as np

from rhizotwin.corrections import surface


def test_faces_beside_cubes_are_found():
    rng = np.random.default_rng(0)
    points, centre, reach = rng.uniform(-5.0, 5.0, (40_000, 3)), rng.uniform(-3.0, 3.0, (30, 3)), rng.uniform(0.05, 0.4, 30)
    inside = (np.abs(points[:, None] - centre[None]) <= reach[None, :, None]).all(axis=2).any(axis=1)
    found = surface._may_be_inside(points, centre, reach)
    assert inside.sum() > 50
    assert found[inside].all()
    assert found.mean() < 0.3
