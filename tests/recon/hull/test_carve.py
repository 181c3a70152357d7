"""Carving a sphere from exact silhouettes drawn with the reference projection; cells, their neighbours and their faces."""

from functools import cache

import mitsuba as mi
import numpy as np
import pytest
from numpy.typing import NDArray

from rhizotwin.recon.coverage import silhouettes
from rhizotwin.recon.hull import carve, distance_maps, leaves, surface
from rhizotwin.recon.hull.boxes import CellSet
from rhizotwin.recon.hull.carve import Water
from rhizotwin.recon.hull.distance_maps import DistanceMaps
from rhizotwin.recon.hull.leaves import Grid, Hull, Leaves
from rhizotwin.recon.optics import projection, refraction
from tests.recon.hull import blocks, exact_pictures

RADIUS_MM = 8.0
BALL_MM3 = 4.0 / 3.0 * np.pi * RADIUS_MM**3
MIDDLE_MM = (0.0, 0.0, -50.0)


@cache
def seen_ball(centre_mm: tuple[float, float, float]) -> tuple[projection.ViewBank, DistanceMaps]:
    scene = exact_pictures.ring_of(24, (240, 180))
    optics = refraction.Optics.from_scene(scene)
    views = exact_pictures.views_of(scene)
    sphere = (centre_mm, (centre_mm[0], centre_mm[1], centre_mm[2] - 1e-3), RADIUS_MM)
    maps = [silhouettes.signed_distance(exact_pictures.drawn(view, optics, (sphere,))) for view in views]
    return projection.ViewBank.pack(views, optics), blocks.maps_of(np.stack(maps))


@cache
def carved(centre_mm: tuple[float, float, float], *, min_votes: int = 5) -> Hull:
    bank, maps = seen_ball(centre_mm)
    r = bank.optics.inner_radius_mm
    grid = Grid.over(np.array([-r, -r, -110.0]), np.array([r, r, -8.0]), 0.4)
    return carve.carve(bank, maps, grid, Water(r, -8.0, -110.0), min_votes=min_votes)


@pytest.mark.parametrize("centre_mm", [MIDDLE_MM, (40.0, 5.0, -50.0)])
def test_volume_of_a_ball(centre_mm: tuple[float, float, float]) -> None:
    hull = carved(centre_mm)
    leaves = hull.leaves
    assert leaves.volume_mm3() == pytest.approx(BALL_MM3, rel=0.025)
    assert hull.moved_in_mm3 < BALL_MM3 < hull.moved_out_mm3
    weight = leaves.occupancy * leaves.size.astype(float) ** 3
    np.testing.assert_allclose(np.average(leaves.middles_mm, axis=0, weights=weight), centre_mm, atol=0.12)


def test_a_ball_at_the_wall_survives_blind_directions() -> None:
    """Beyond R_o / n_w from the axis some views are blind; carving there, as the thesis does, loses the sphere."""
    centre_mm = (64.0, 0.0, -50.0)
    assert carved(centre_mm).leaves.volume_mm3() == pytest.approx(BALL_MM3, rel=0.15)
    assert carved(centre_mm, min_votes=24).leaves.volume_mm3() < 0.6 * BALL_MM3


def test_a_ball_reaches_as_high_as_enough_views_see() -> None:
    """The pictures say nothing above some row; large nodes that the edge of the blind zone cuts are not blind as a whole."""
    bank, maps = seen_ball(MIDDLE_MM)
    row = float(np.array(distance_maps.project_and_read(bank, maps, mi.UInt32(0), mi.Point3f(0.0, 0.0, -47.3), mi.Bool(True))[0].px.y)[0])
    values = np.array(maps.values).reshape(bank.count, 360, 480)
    values[:, : int(2 * row)] = np.inf
    half = blocks.maps_of(values)
    grid = Grid.over(np.array([-12.0, -12.0, -62.0]), np.array([12.0, 12.0, -38.0]), 0.4)
    leaves = carve.carve(bank, half, grid, Water(73.0, -38.0, -62.0), min_votes=5).leaves
    z = np.arange(-50.0, -40.0, 0.05)
    point = mi.Point3f(0.2, 0.2, mi.Float(z))
    told = [distance_maps.project_and_read(bank, half, mi.UInt32(view), point, mi.Bool(True))[2] for view in range(bank.count)]
    votes = np.sum([np.array(one, int) for one in told], axis=0)
    on_axis = np.floor((0.2 - leaves.grid.origin_mm[:2]) / 0.4)
    column = (leaves.index[:, :2] <= on_axis).all(axis=1) & (leaves.index[:, :2] + leaves.size[:, None] > on_axis).all(axis=1)
    top = leaves.grid.origin_mm[2] + 0.4 * (leaves.index[:, 2] + leaves.size)[column].max()
    assert top == pytest.approx(z[votes >= 5].max(), abs=0.41)


def test_surface_is_closed_and_holds_the_volume() -> None:
    leaves = carved(MIDDLE_MM).leaves
    mesh = surface.surface(leaves)
    assert mesh.is_watertight
    assert abs(mesh.volume) == pytest.approx(leaves.volume_mm3(), rel=0.01)
    np.testing.assert_allclose(mesh.bounds[1] - mesh.bounds[0], 2 * RADIUS_MM, atol=0.35)


def test_scattered_cells_know_their_neighbours() -> None:
    rng = np.random.default_rng(1)
    index = rng.permutation(np.unique(rng.integers(-5, 4, (300, 3)), axis=0)).astype(np.int32)
    cells = CellSet.from_cells(index)
    away = index[:, None] - index
    joined = np.zeros((len(index), len(index)), int)
    for step, here, there in cells.neighbours():
        np.testing.assert_array_equal(index[there] - index[here], np.broadcast_to(step, (len(here), 3)))
        joined[here, there] += 1
        joined[there, here] += 1
    np.testing.assert_array_equal(joined, (np.abs(away).max(axis=2) == 1).astype(int))
    together = joined + np.eye(len(index), dtype=int) > 0
    for _ in range(9):
        together = together @ together
    part = cells.components()
    np.testing.assert_array_equal(part[:, None] == part, together)
    asked = np.stack(np.meshgrid(*[np.arange(-9, 9)] * 3, indexing="ij"), -1).reshape(-1, 3)
    np.testing.assert_array_equal(cells.contains(asked), (asked[:, None] == index).all(axis=2).any(axis=1))


def test_faces_lie_between_cells_and_empty_ones() -> None:
    index = np.argwhere(np.random.default_rng(2).random((6, 7, 8)) < 0.9)
    full = np.zeros((8, 9, 10), bool)
    full[tuple((index + 1).T)] = True
    around = np.stack([np.roll(full, shift, axis) for axis in range(3) for shift in (-1, 1)])
    rim, beyond = CellSet.from_cells(index).faces()
    np.testing.assert_array_equal(np.sort(rim), np.flatnonzero(~around.all(axis=0)[tuple((index + 1).T)]))
    np.testing.assert_array_equal(beyond, np.argwhere(~full & around.any(axis=0)) - 1)


GRID = Grid(np.zeros(3), 1.0, 2, (2, 2, 2))


def cut(seed: int) -> Leaves:
    """Return random leaves: some nodes of 4 whole, others cut into 2 and 1, the finest partly full, some missing."""
    rng, index, size = np.random.default_rng(seed), list[NDArray[np.int64]](), list[int]()
    waiting = [(np.array(at) * 4, 4) for at in np.ndindex(2, 2, 2)]
    while waiting:
        low, edge = waiting.pop()
        chance = rng.random()
        if edge > 1 and chance < 0.5:
            waiting += [(low + np.array(step) * edge // 2, edge // 2) for step in np.ndindex(2, 2, 2)]
        elif chance < 0.8:
            index.append(low)
            size.append(edge)
    full = np.where(np.array(size) > 1, 1.0, rng.random(len(size))).astype(np.float32)
    return Leaves(GRID, np.array(index, np.int32), np.array(size, np.int32), full)


def dense(some: Leaves) -> NDArray[np.float32]:
    """Return how full each finest node (8, 8, 8) is."""
    whole = np.zeros((8, 8, 8), np.float32)
    for (x, y, z), edge, full in zip(some.index, some.size, some.occupancy, strict=True):
        assert not whole[x : x + edge, y : y + edge, z : z + edge].any()
        whole[x : x + edge, y : y + edge, z : z + edge] = full
    return whole


@pytest.mark.parametrize("seed", range(2))
def test_leaves_are_combined_as_their_nodes_are(seed: int) -> None:
    a, b = cut(2 * seed), cut(2 * seed + 1)
    np.testing.assert_array_equal(dense(leaves.unite(a, b)), np.maximum(dense(a), dense(b)))
    rest = leaves.subtract(b, a)
    more = rest.select(rest.size == 1)
    np.testing.assert_allclose(dense(leaves.fill_up(a, more)), dense(a) + dense(more))
    np.testing.assert_array_equal(dense(leaves.subtract(a, b)), np.maximum(dense(a) - dense(b), 0.0))
    np.testing.assert_array_equal(a.occupancy_at(np.argwhere(np.ones((8, 8, 8), bool)).astype(np.int32)), dense(a).ravel())
    np.testing.assert_array_equal(dense(a.split()), dense(a))
    assert a.merge(1).volume_mm3() == pytest.approx(a.volume_mm3())
    nothing = a.select(slice(0))
    np.testing.assert_array_equal(dense(leaves.subtract(a, nothing)), dense(a))
    assert len(leaves.subtract(nothing, a).size) == 0
