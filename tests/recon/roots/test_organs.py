"""Thick organs among the tubes: told from crowds, as wide as their spheres, and on their axes."""

import numpy as np

from rhizotwin.recon.hull.leaves import Grid
from rhizotwin.recon.hull.spheres import Spheres
from rhizotwin.recon.roots import organs
from rhizotwin.recon.roots.density import Cells
from tests.recon.lines import line
from tests.recon.strings import pictured, strung


def test_what_is_thinner_than_an_organ_is_no_core():
    grid = Grid(np.zeros(3), 0.5, 1, (8, 8, 8))
    index = np.stack(np.meshgrid(*[np.arange(16)] * 3, indexing="ij"), -1).reshape(-1, 3).astype(np.int32)
    core = Cells(grid, index, np.zeros(len(index), np.float32))
    spheres = Spheres(np.array([[2.0, 2.0, 2.0], [6.0, 6.0, 6.0]]), np.array([1.0, 0.5]))
    kept = organs.thick(core, spheres, 0.75)
    assert len(kept.index) > 0
    away = np.linalg.norm(core.centre_mm - 2.0, axis=1)
    np.testing.assert_array_equal(kept.index, core.index[away < 3.0**0.5])  # a cube's corner lies so far from its largest sphere's centre
    thin = core.chosen(core.index[:, 2] < 4)
    assert not len(organs.thick(thin, spheres, 1.5).index)


def test_a_deep_core_without_a_ball_is_a_solid():
    """Few views bound the spheres in a box, so that it has none: it is no crowd all the same, and no root."""
    grid = Grid(np.array([0.0, 0.0, -30.0]), 0.5, 1, (20, 20, 40))
    index = np.stack(np.meshgrid(*[np.arange(12)] * 3, indexing="ij"), -1).reshape(-1, 3).astype(np.int32)
    core = Cells(grid, index, np.zeros(len(index), np.float32))
    twig = Spheres(np.array([[9.0, 9.0, -10.0]]), np.array([0.5]))
    kept = organs.thick(core, twig, 1.5)
    assert len(kept.index) == len(index)
    tree = strung(line((3.0, 3.0, -30.0), (3.0, 3.0, -24.0)))
    _, buried, organ = organs.thicken(tree, kept, twig, 0.5)
    assert buried.all()
    assert not organ.any()
    assert organs.in_solids(tree, kept, organ, 0.5).all()


def test_where_a_thick_organ_lies_pictures_tell_nothing_of_tubes():
    seen = pictured(strung(line((0.0, 0.0, -20.0), (0.0, 0.0, -30.0)), radius_mm=1.5))
    grid = Grid(np.array([-2.0, -2.0, -32.0]), 0.25, 1, (20, 20, 60))
    cell = np.stack(np.meshgrid(np.arange(16), np.arange(16), np.arange(8, 48), indexing="ij"), -1).reshape(-1, 3).astype(np.int32)
    core = Cells(grid, cell, np.zeros(len(cell), np.float32))
    core = core.chosen(np.linalg.norm(core.centre_mm[:, :2], axis=1) < 1.0)
    covered = organs.footprint(seen, core, 2.5)
    picture = np.stack([silhouette.coverage for silhouette in seen.silhouettes])
    inner = np.abs(seen.project(np.array([[0.0, 0.0, -25.0]])).px[:, 0, 1].round().astype(int))
    for view, row in enumerate(inner):
        assert covered[view, row][picture[view, row] > 0.05].all()
    assert covered.sum() < 1.7 * (picture > 0.05).sum()
    beside = seen.beside(covered)
    assert float(np.array(beside.seen).reshape(covered.shape)[covered].max()) == 0.0


def test_a_ball_is_a_solid_and_a_taproot_is_none():
    taproot, lateral = line((0.0, 0.0, -20.0), (0.0, 0.0, -40.0)), line((8.0, 0.0, -30.0), (14.0, 0.0, -34.0))
    tree = strung(taproot, lateral)
    grid = Grid(np.array([-2.0, -2.0, -42.0]), 0.5, 1, (40, 20, 50))
    cell = np.stack(np.meshgrid(np.arange(40), np.arange(20), np.arange(50), indexing="ij"), -1).reshape(-1, 3).astype(np.int32)
    cells = Cells(grid, cell, np.zeros(len(cell), np.float32))
    root = (np.linalg.norm(cells.centre_mm[:, :2], axis=1) < 0.6) & (cells.centre_mm[:, 2] > -40.0) & (cells.centre_mm[:, 2] < -20.0)
    sphere = np.linalg.norm(cells.centre_mm - [9.0, 0.0, -30.0], axis=1) < 2.0
    core = cells.chosen(root | sphere)
    organ = tree.owner == 0
    solid = organs.in_solids(tree, core, organ, 0.5)
    assert not solid[organ].any()
    away = np.linalg.norm(tree.centre_mm - [9.0, 0.0, -30.0], axis=1)
    assert solid[~organ & (away < 1.5)].all()
    assert not solid[away > 2.5].any()


def test_what_is_wide_begins_wide_where_its_core_has_a_gap():
    thick = line((0.0, 0.0, -20.0), (0.0, 0.0, -26.0))
    spheres = Spheres(thick, np.full(len(thick), 0.9))
    grid = Grid(np.array([-2.0, -2.0, -28.0]), 0.2, 1, (20, 20, 40))
    deep = np.array([[10, 10, k] for k in range(10, 40) if not 30 <= k < 34], np.int32)  # 4 of 30 cells are missing near the top
    core = Cells(grid, deep, np.zeros(len(deep), np.float32))
    started, buried, organ = organs.thicken(strung(thick), core, spheres, 0.3)
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
    spheres = Spheres(axis[::4], np.full(len(axis[::4]), 0.9))
    centred, _, organ = organs.centred(strung(strayed), core, spheres, 0.3)
    assert organ.all()
    assert np.linalg.norm(centred.centre_mm[:, :2], axis=1).max() < 0.08
    np.testing.assert_allclose(centred.centre_mm[[0, -1], 2], (-20.0, -28.0), atol=0.05)
