"""Thick organs among the tubes: as wide as their spheres, and on their axes."""

import numpy as np

from rhizotwin.recon.hull.leaves import Grid
from rhizotwin.recon.hull.spheres import Spheres
from rhizotwin.recon.roots import organs
from rhizotwin.recon.roots.density import Cells
from tests.recon.strings import line, strung


def cells(low_mm: tuple[float, float, float], cell_mm: float, count: tuple[int, int, int]) -> Cells:
    """Return all cells of a box."""
    index = np.argwhere(np.ones(count, bool)).astype(np.int32)
    return Cells(Grid(np.array(low_mm), cell_mm, 1, count), index, np.zeros(len(index), np.float32))


def test_organs_are_as_wide_and_stand_where_their_balls_do() -> None:
    """The core has a gap near the top, where the path strays by half a radius; the tube stays on the organ's axis, and as long."""
    axis = line((0.0, 0.0, -20.0), (0.0, 0.0, -28.0))
    spheres, core = Spheres(axis, np.full(len(axis), 0.9)), cells((0.0, 0.0, -28.0), 0.2, (3, 1, 40))
    torn = core.chosen((core.index[:, 0] == 0) & ((core.index[:, 2] < 28) | (core.index[:, 2] >= 34)))
    started, buried, organ = organs.thicken(strung(axis), torn, spheres, 0.3)
    assert not buried.all()
    assert organ.all()
    np.testing.assert_allclose(started.radius_mm, 0.9)
    strayed = axis + np.outer(np.where(axis[:, 2] > -23.0, 0.5, 0.0), [1.0, 0.0, 0.0])
    centred, _, organ = organs.centred(strung(strayed), core, spheres, 0.3)
    assert organ.all()
    assert np.linalg.norm(centred.centre_mm[:, :2], axis=1).max() < 0.08
    np.testing.assert_allclose(centred.centre_mm[[0, -1], 2], (-20.0, -28.0), atol=0.05)
