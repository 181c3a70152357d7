"""Roots of two plants in one canister are given to the plant at whose base they hang."""

from dataclasses import replace

import numpy as np
import pytest

from rhizotwin.recon.roots import plants
from rhizotwin.scenes.plants import Plant
from rhizotwin.scenes.rsml import Root, length_mm, plant_roots
from tests.recon.strings import root

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
