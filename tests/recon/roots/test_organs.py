"""Thick organs among the tubes: told from crowds, as wide as their spheres, and on their axes."""

import numpy as np

from rhizotwin.recon.hull.leaves import Grid
from rhizotwin.recon.hull.spheres import Spheres
from rhizotwin.recon.roots import organs
from rhizotwin.recon.roots.density import Cells
from tests.recon.strings import line, pictured, strung


def cells(low_mm: tuple[float, float, float], cell_mm: float, count: tuple[int, int, int]) -> Cells:
    """Return all cells of a box."""
    index = np.argwhere(np.ones(count, bool)).astype(np.int32)
    return Cells(Grid(np.array(low_mm), cell_mm, 1, count), index, np.zeros(len(index), np.float32))


def test_what_is_thinner_than_an_organ_is_no_core_and_what_is_deep_without_a_ball_is() -> None:
    """Few views bound the spheres in a box, so that it has none: it is no crowd all the same, and no root."""
    core = cells((0.0, 0.0, 0.0), 0.5, (16, 16, 16))
    spheres = Spheres(np.array([[2.0, 2.0, 2.0], [6.0, 6.0, 6.0]]), np.array([1.0, 0.5]))
    away = np.linalg.norm(core.centre_mm - 2.0, axis=1)
    # a cube's corner lies sqrt(3) radii from its largest sphere's centre
    np.testing.assert_array_equal(organs.thick(core, spheres, 0.75).index, core.index[away < 3.0**0.5])
    twig = Spheres(np.array([[9.0, 9.0, -10.0]]), np.array([0.5]))
    assert not len(organs.thick(core.chosen(core.index[:, 2] < 4), twig, 1.5).index)
    box = cells((0.0, 0.0, -30.0), 0.5, (12, 12, 12))
    kept, tree = organs.thick(box, twig, 1.5), strung(line((3.0, 3.0, -30.0), (3.0, 3.0, -24.0)))
    assert len(kept.index) == len(box.index)
    _, buried, organ = organs.thicken(tree, kept, twig, 0.5)
    assert buried.all()
    assert not organ.any()
    assert organs.in_solids(tree, kept, organ, 0.5).all()


def test_where_a_thick_organ_lies_pictures_tell_nothing_of_tubes() -> None:
    seen = pictured(strung(line((0.0, 0.0, -20.0), (0.0, 0.0, -30.0)), radius_mm=1.5))
    core = cells((-2.0, -2.0, -30.0), 0.25, (16, 16, 40))
    covered = organs.footprint(seen, core.chosen(np.linalg.norm(core.centre_mm[:, :2], axis=1) < 1.0), 2.5)
    picture = np.stack([silhouette.coverage for silhouette in seen.silhouettes])
    inner = np.abs(seen.project(np.array([[0.0, 0.0, -25.0]])).px[:, 0, 1].round().astype(int))
    for view, row in enumerate(inner):
        assert covered[view, row][picture[view, row] > 0.05].all()
    assert covered.sum() < 1.7 * (picture > 0.05).sum()
    beside = seen.beside(covered)
    assert float(np.array(beside.seen).reshape(covered.shape)[covered].max()) == 0.0


def test_a_ball_is_a_solid_and_a_taproot_is_none() -> None:
    tree = strung(line((0.0, 0.0, -20.0), (0.0, 0.0, -40.0)), line((8.0, 0.0, -30.0), (14.0, 0.0, -34.0)))
    every = cells((-2.0, -2.0, -42.0), 0.5, (40, 20, 50))
    x, y, z = every.centre_mm.T
    root, sphere = (np.hypot(x, y) < 0.6) & (z > -40.0) & (z < -20.0), np.linalg.norm(every.centre_mm - [9.0, 0.0, -30.0], axis=1) < 2.0
    organ = tree.owner == 0
    solid = organs.in_solids(tree, every.chosen(root | sphere), organ, 0.5)
    away = np.linalg.norm(tree.centre_mm - [9.0, 0.0, -30.0], axis=1)
    assert not solid[organ | (away > 2.5)].any()
    assert solid[~organ & (away < 1.5)].all()


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
