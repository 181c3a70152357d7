"""Two plants in one canister: their roots are found, though tracing knows one tree, and given to the plant at whose base they hang."""

from dataclasses import replace

import numpy as np
import pytest

from rhizotwin.recon.coverage.evidence import Evidence
from rhizotwin.recon.coverage.silhouettes import Silhouette
from rhizotwin.recon.hull.carve import Water
from rhizotwin.recon.roots import crown, plants, rooting
from rhizotwin.recon.tubes.tubes import SPACING_MM
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.monitor import Monitor
from rhizotwin.scenes.plants import Plant
from rhizotwin.scenes.rsml import Root, length_mm, plant_roots
from tests.recon.strings import line, pictured, root, standing, strung

GRID_MM = -8.0
A, B = Plant(plant="A", at_mm=(-12.0, 0.0)), Plant(plant="B", at_mm=(12.0, 0.0))


def tap(plant: Plant) -> Root:
    x, y = plant.at_mm
    return root([x, y, -11], [x, y, -50], diameters=(1.2, 0.4))


def test_a_tree_that_reaches_both_bases_is_divided():
    touch = [0.5, 0, -30]
    of_a = root([-12, 0, -20], touch, [3, 0, -33], diameters=(0.4, 0.2), parent=0, order=1)
    up = root([0.5, 0, -30], [12, 0, -20], diameters=(0.25, 0.4), parent=1, order=2)  # B's lateral, traced from its tip
    tap_b = root([12, 0, -20], [12, 0, -11], diameters=(1.1, 1.2), parent=2, order=3)  # the upper half of B's taproot, upside down
    below = root([12, 0, -20], [12, 0, -50], diameters=(1.1, 0.4), parent=2, order=3)
    roots = [tap(A), of_a, up, tap_b, below]
    given = plants.assign(roots, (A, B), grid_z_mm=GRID_MM)
    assert not given.missing
    own = [plant_roots(given.roots, plant) for plant in "AB"]
    assert [one[0].parent for one in own] == [-1, -1]
    ends = np.array([one[0].points_mm[[0, -1]] for one in own])
    np.testing.assert_allclose(ends, [[[x, 0, -11], [x, 0, -50]] for x in (-12, 12)], atol=1e-9)
    of_a, of_b = (np.concatenate([root.points_mm[:, 0] for root in one[1:]]) for one in own)
    assert of_a.max() < 4.0  # A's lateral ends at x = 3, B's begins to its right
    assert of_b.min() > -4.0
    assert abs(length_mm(given.roots) - length_mm(roots)) < 1.0  # the step of the cut is lost, not more


def test_a_torn_piece_goes_to_the_nearest_plant():
    near_a, between = root([-8, 0, -30], [-5, 0, -33]), root([0.2, 0, -30], [0.2, 0, -40])
    given = plants.assign([tap(A), tap(B), near_a, between], (A, B), grid_z_mm=GRID_MM)
    assert [one.plant for one in given.roots] == ["A", "B", "A", given.roots[3].plant]
    assert given.open == (False, False, False, True)  # between two
    assert {one.plant for one in plants.assign([tap(A), tap(B)], (A,), grid_z_mm=GRID_MM).roots} == {"A"}
    assert plants.assign([tap(A)], (A, B), grid_z_mm=GRID_MM).missing == ("B",)


@pytest.mark.parametrize("hidden_mm", [2.4, 3.2, 7.0])
def test_close_plants_have_bases_below_what_the_pot_hides(hidden_mm: float):
    close = [replace(A, at_mm=(-3.0, 0.0)), replace(B, at_mm=(3.0, 0.0))]
    first_mm = GRID_MM - hidden_mm
    roots = [root([x, y, first_mm], [x, y, -50], diameters=(1.2, 0.4)) for x, y in (one.at_mm for one in close)]
    given = plants.assign(roots, close, grid_z_mm=GRID_MM)
    assert (given.missing, given.open) == ((), (False, False))
    assert [one.plant for one in given.roots] == ["A", "B"]
    beside = root([0.0, 3.1, first_mm], [0.0, 3.1, -50])
    assert plants.assign([beside], close, grid_z_mm=GRID_MM).missing == ("A", "B"), "farther from both than half their distance"


def paths(plant: Plant) -> list[np.ndarray]:
    """Return a taproot and two laterals, one towards the other plant."""
    x, side = plant.at_mm[0], float(np.sign(plant.at_mm[0]))
    taproot = line((x, 0.0, -11.0), (x, 0.0, -45.0))
    return [taproot, line((x, 0.0, -20.0), (x - side * 9, 3.0, -32.0)), line((x, 0.0, -26.0), (x + side * 6, -4.0, -38.0))]


def test_both_plants_are_found_each_with_its_roots() -> None:
    true = {plant.plant: strung(*paths(plant), radius_mm=0.3) for plant in (A, B)}
    pictures = [pictured(one) for one in true.values()]
    lowest_row = pictures[0].project(np.array([[0.0, 0.0, -10.0]])).px[:, 0, 1]  # above it the net pot hides all
    coverage = np.maximum(*(np.array([one.coverage for one in picture.silhouettes]) for picture in pictures))
    seen = np.broadcast_to(np.arange(coverage.shape[1])[:, None] > lowest_row[:, None, None], coverage.shape)
    drawn = [Silhouette(one, told) for one, told in zip(np.where(seen, coverage, 0.0).astype(np.float32), seen.copy(), strict=True)]
    scene = replace(Scene(), plants=(A, B))
    tops = crown.tops(scene)
    assert all(scene.net_pot.grid_z_mm < z < scene.net_pot.top_mm for _, _, z in tops)
    assert crown.tops(replace(scene, plants=(A,))) == ((0.0, 0.0, tops[0][2]),)
    evidence = replace(Evidence.from_silhouettes(pictures[0].bank, drawn), tops_mm=tops)
    tree = rooting.find_tree(evidence, standing(), Water(35.0, GRID_MM, -60.0), np.inf, monitor=Monitor())
    assert tree is not None
    system = crown.mark_hidden(rooting.finish_tree(tree, monitor=Monitor()), GRID_MM)
    given = plants.assign(system.roots(), (A, B), grid_z_mm=GRID_MM)
    assert not given.missing
    own = [plant_roots(given.roots, plant.plant) for plant in (A, B)]
    assert [[root.order for root in roots] for roots in own] == [[0, 1, 1]] * 2
    begin = [roots[0].points_mm[0] for roots in own]
    np.testing.assert_allclose(begin, [[*plant.at_mm, -11.0] for plant in (A, B)], atol=1.5 * SPACING_MM)  # the crown is no root
    assert [length_mm(roots) for roots in own] == pytest.approx([one.length_mm for one in true.values()], rel=0.02)
    assert [np.median(roots[1].diameters_mm) for roots in own] == pytest.approx([0.6, 0.6], rel=0.05)
