"""Plants that share a canister: where they hang, and distances, zones and common hulls that are worked out by hand."""

import numpy as np
import pytest

from rhizotwin.scenes.neighbours import HEAD, find_neighbours, rows
from rhizotwin.scenes.plants import Plant
from rhizotwin.scenes.rsml import Root
from rhizotwin.scenes.specimens import GrownSpecimen, MeshSpecimen


def rod(plant: str, start: tuple[float, float, float], end: tuple[float, float, float], *, diameter_mm: float = 1.0) -> Root:
    points = np.linspace(start, end, 11)
    return Root(points_mm=points, diameters_mm=np.full(11, diameter_mm), order=0, parent=-1, plant=plant)


def test_parallel_rods_are_near_where_they_stand_side_by_side() -> None:
    """Rods of 1 mm, axes 2.5 mm apart: surfaces 1.5 mm apart; the second one reaches 20 mm deeper."""
    roots = [rod("A", (0.0, 0.0, 0.0), (0.0, 0.0, -40.0)), rod("B", (2.5, 0.0, -20.0), (2.5, 0.0, -60.0))]
    (found,) = find_neighbours(roots)
    assert found.plants == ("A", "B")
    assert found.nearest_mm == pytest.approx(1.5, abs=0.01)
    assert found.contact_mm == (0.0, 0.0)
    # a little beyond the end of the other: sqrt(3^2 - 2.5^2) = 1.66 mm
    assert found.zone_mm == pytest.approx((21.66, 21.66), abs=0.3)
    assert found.zone_share == pytest.approx((21.66 / 40.0, 21.66 / 40.0), abs=0.01)
    assert found.zone_share_by_depth[0] == pytest.approx((0.0, 0.166, 1.0, 1.0), abs=0.02)
    assert found.zone_share_by_depth[1] == pytest.approx((0.0, 0.0, 1.0, 1.0, 0.166, 0.0), abs=0.02)


def test_crossing_rods_touch() -> None:
    roots = [rod("A", (-20.0, 0.0, -30.0), (20.0, 0.0, -30.0)), rod("B", (0.0, -20.0, -30.9), (0.0, 20.0, -30.9))]
    (found,) = find_neighbours(roots)
    assert found.nearest_mm == 0.0
    # surfaces meet within sqrt(1 - 0.9^2) = 0.436 mm either way
    assert found.contact_mm == pytest.approx((0.87, 0.87), abs=0.26)
    assert found.lines("reliable")[0] == "A and B: their roots touch"


def test_the_common_volume_of_two_boxes() -> None:
    """Boxes of 20 mm whose corners are the roots' ends, the second one moved by 5 mm: three quarters are common."""

    def box(plant: str, x: float) -> list[Root]:
        corners = [(x + i, j, -50.0 + k) for i in (0.0, 20.0) for j in (0.0, 20.0) for k in (0.0, 20.0)]
        return [rod(plant, a, b) for a, b in zip(corners[::2], corners[1::2], strict=True)]

    (found,) = find_neighbours([*box("A", 0.0), *box("B", 5.0)])
    assert found.hulls_overlap_share == pytest.approx((0.75, 0.75), abs=0.02)


def test_one_plant_has_no_neighbours_and_three_have_three_pairs() -> None:
    one = rod("A", (0.0, 0.0, 0.0), (0.0, 0.0, -40.0))
    assert find_neighbours([one, rod("", (9.0, 0.0, 0.0), (9.0, 0.0, -10.0))]) == ()
    others = [rod(name, (x, 0.0, 0.0), (x, 0.0, -40.0)) for name, x in (("B", 10.0), ("C", 20.0))]
    assert [pair.plants for pair in find_neighbours([one, *others])] == [("A", "B"), ("A", "C"), ("B", "C")]


def test_rows_have_the_whole_and_each_depth() -> None:
    found = find_neighbours([rod("A", (0.0, 0.0, 0.0), (0.0, 0.0, -19.0)), rod("B", (2.5, 0.0, 0.0), (2.5, 0.0, -9.0))])
    table = rows(found)
    assert all(len(row) == len(HEAD) for row in table)
    assert [(row[0], row[8]) for row in table] == [("A", ""), ("A", "0"), ("A", "10"), ("B", ""), ("B", "0")]
    assert float(table[1][9]) == pytest.approx(1.0)


def test_specimens_stand_where_their_plants_hang() -> None:
    assert Plant(plant="A", at_mm=(5.0, -3.0), specimen=GrownSpecimen()).placed() == GrownSpecimen(origin_mm=(5.0, -3.0, -10.5))
    moved = Plant(plant="A", at_mm=(5.0, 0.0), specimen=MeshSpecimen(file="a.stl", shift_mm=(1.0, 0.0, -9.0))).placed()
    assert moved == MeshSpecimen(file="a.stl", shift_mm=(6.0, 0.0, -9.0))
    assert Plant(plant="A").placed() is None
