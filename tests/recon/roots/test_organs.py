"""Thick organs among the tubes: told from crowds, as wide as their balls, and on their axes."""

import numpy as np

from rhizotwin.recon.hull.carve import Grid
from rhizotwin.recon.hull.parsimony import Balls
from rhizotwin.recon.roots import organs
from rhizotwin.recon.roots.density import Cells
from tests.recon.lines import line
from tests.recon.strings import strung


def test_what_is_thinner_than_an_organ_is_no_core():
    grid = Grid(np.zeros(3), 0.5, 1, (8, 8, 8))
    index = np.stack(np.meshgrid(*[np.arange(16)] * 3, indexing="ij"), -1).reshape(-1, 3).astype(np.int32)
    core = Cells(grid, index, np.zeros(len(index), np.float32))
    balls = Balls(np.array([[2.0, 2.0, 2.0], [6.0, 6.0, 6.0]]), np.array([1.0, 0.5]))
    kept = organs.thick(core, balls, 0.75)
    assert len(kept.index) > 0
    np.testing.assert_array_equal(np.linalg.norm(kept.centre_mm - 2.0, axis=1) <= 1.0, True)
    assert not len(organs.thick(core, balls, 1.5).index)


def test_what_is_wide_begins_wide_where_its_core_has_a_gap():
    thick = line((0.0, 0.0, -20.0), (0.0, 0.0, -26.0))
    balls = Balls(thick, np.full(len(thick), 0.9))
    grid = Grid(np.array([-2.0, -2.0, -28.0]), 0.2, 1, (20, 20, 40))
    deep = np.array([[10, 10, k] for k in range(10, 40) if not 30 <= k < 34], np.int32)  # 4 of 30 cells are missing near the top
    core = Cells(grid, deep, np.zeros(len(deep), np.float32))
    started, buried, organ = organs.thicken(strung(thick), core, balls, 0.3)
    assert not buried.all()
    assert organ.all()
    np.testing.assert_allclose(started.radius_mm, 0.9)


def test_organs_stand_where_their_balls_do():
    """The path through a torn core strays by half a radius near the top; the organ's tube stays on its axis, and as long."""
    axis = line((0.0, 0.0, -20.0), (0.0, 0.0, -28.0))
    strayed = axis + np.outer(np.where(axis[:, 2] > -23.0, 0.5, 0.0), [1.0, 0.0, 0.0])
    grid = Grid(np.array([-2.0, -2.0, -30.0]), 0.2, 1, (20, 20, 60))
    deep = np.array([[i, 10, k] for i in (10, 11, 12) for k in range(10, 50)], np.int32)
    core = Cells(grid, deep, np.zeros(len(deep), np.float32))
    balls = Balls(axis[::4], np.full(len(axis[::4]), 0.9))
    centred, _, organ = organs.centred(strung(strayed), core, balls, 0.3)
    assert organ.all()
    assert np.linalg.norm(centred.centre_mm[:, :2], axis=1).max() < 0.08
    np.testing.assert_allclose(centred.centre_mm[[0, -1], 2], (-20.0, -28.0), atol=0.05)
