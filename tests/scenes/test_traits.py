"""Traits of small root systems that can be counted by hand, their tables, and those of plants that share a canister."""

from dataclasses import fields, replace
from functools import partial

import numpy as np
import pytest

from rhizotwin.scenes.assessment import Assessment
from rhizotwin.scenes.neighbours import find_neighbours
from rhizotwin.scenes.plants import Plant
from rhizotwin.scenes.rsml import Root
from rhizotwin.scenes.specimens import GrownSpecimen, MeshSpecimen
from rhizotwin.scenes.trait_table import DEFINITIONS, HISTOGRAMS, PROFILES, to_csv
from rhizotwin.scenes.traits import Traits, measure_traits
from tests.roots import straight

RNG = np.random.default_rng(0)


line = partial(straight, count=41)
TAP = line([0.0, 0.0, -10.0], [0.0, 0.0, -50.0], 2.0)
LEFT = line([0.0, 0.0, -20.0], [-20.0, 0.0, -20.0], 1.0, order=1, parent=0)
RIGHT = line([0.0, 0.0, -20.0], [15.0, 0.0, -35.0], 0.55, order=1, parent=0)
BOX = np.array([[x, y, z] for x in (-20.0, 15.0) for y in (-1.0, 1.0) for z in (-50.0, -10.0)])


def test_a_tree_of_three_roots():
    found = measure_traits([TAP, LEFT, RIGHT], BOX, volume_mm3=140.0, surface_mm2=300.0, mass_g=0.14)
    slanted = 15.0 * np.sqrt(2.0)
    total = 40.0 + 20.0 + slanted
    assert found.total_length_mm == pytest.approx(total)
    assert found.mean_diameter_mm == pytest.approx((40.0 * 2.0 + 20.0 + slanted * 0.55) / total)
    assert (found.median_diameter_mm, found.max_diameter_mm) == pytest.approx((1.0, 2.0))
    assert (found.roots, found.tips, found.branch_points) == (3, 3, 2)
    assert found.depth_mm == pytest.approx(40.0)
    assert found.width_mm == pytest.approx(np.hypot(35.0, 2.0))
    assert found.convex_hull_mm3 == pytest.approx(35.0 * 2.0 * 40.0)
    assert found.solidity == pytest.approx(140.0 / 2800.0)
    assert found.length_by_order_mm == pytest.approx((40.0, 20.0 + slanted))
    assert found.length_by_depth_mm == pytest.approx((10.0, 10.0 + 20.0 + 10.0 * np.sqrt(2.0), 10.0 + 5.0 * np.sqrt(2.0), 10.0))
    assert found.width_by_depth_mm == pytest.approx((0.0, 30.0, 15.0, 0.0), abs=0.5)  # the next point is at most 0.5 mm away
    assert found.length_by_diameter_mm[5] == pytest.approx(slanted)
    assert found.angle_to_gravity_deg == pytest.approx((0.0 * 40.0 + 90.0 * 20.0 + 45.0 * slanted) / total, abs=1e-5)
    assert found.angle_to_parent_deg == pytest.approx((90.0 + 45.0) / 2.0, abs=1e-5)
    assert found.specific_root_length_m_per_g == pytest.approx(total / 1000.0 / 0.14)
    assert found.tissue_density_g_per_ml == pytest.approx(1.0)
    assert measure_traits([TAP, replace(LEFT, tip_seen=False), RIGHT], BOX, volume_mm3=140.0, surface_mm2=300.0).tips == 2


def test_bushiness_is_the_84th_percentile_over_the_median_count():
    stems = [line([x, 0.0, 0.0], [x, 0.0, -10.0], 1.0) for x in range(3)] + [line([9.0, 0.0, 0.0], [9.0, 0.0, -40.0], 1.0)]
    found = measure_traits(stems, RNG.normal(size=(30, 3)), volume_mm3=1.0, surface_mm2=1.0)
    assert (found.max_root_count, found.median_root_count, found.bushiness) == (4.0, 1.0, 4.0)  # a quarter of the planes meets four
    short = [line([x, 0.0, 0.0], [x, 0.0, -5.0], 1.0) for x in range(3)] + [stems[3]]
    found = measure_traits(short, RNG.normal(size=(30, 3)), volume_mm3=1.0, surface_mm2=1.0)
    assert found.bushiness == 1.0  # an eighth does: below the 84th percentile, one whorl does not decide


def test_the_angle_to_the_parent_is_that_of_the_first_5_mm():
    """A lateral leaves level for 5 mm and then hangs straight down."""
    level, down = line([0.0, 0.0, -20.0], [5.0, 0.0, -20.0], 0.3, count=11), line([5.0, 0.0, -20.0], [5.0, 0.0, -40.0], 0.3)
    bent = replace(level, points_mm=np.concatenate([level.points_mm, down.points_mm[1:]]), diameters_mm=np.full(51, 0.3), order=1, parent=0)
    found = measure_traits([TAP, bent], BOX, volume_mm3=1.0, surface_mm2=1.0)
    assert found.angle_to_parent_deg == pytest.approx(90.0)


@pytest.mark.parametrize("tenths", [3, 7, 14])
def test_a_round_diameter_falls_into_the_bin_that_begins_with_it(tenths):
    found = measure_traits([line([0, 0, 0], [0, 0, -30], tenths / 10.0)], BOX, volume_mm3=1.0, surface_mm2=1.0)
    assert np.flatnonzero(found.length_by_diameter_mm).tolist() == [tenths]


def test_the_lower_share_divides_pieces():
    tap = line([0.0, 0.0, 0.0], [0.0, 0.0, -30.0], 1.0, count=2)
    found = measure_traits([tap], tap.points_mm, volume_mm3=1.0, surface_mm2=1.0)
    assert found.lower_length_share == pytest.approx(2.0 / 3.0)
    assert found.length_by_depth_mm == pytest.approx((10.0, 10.0, 10.0))


def test_without_centre_lines_only_the_solid_is_measured():
    found = measure_traits([], BOX, volume_mm3=1400.0, surface_mm2=1.0, mass_g=2.8)
    assert (found.volume_mm3, found.solidity, found.depth_mm) == (1400.0, pytest.approx(0.5), 40.0)
    assert found.tissue_density_g_per_ml == pytest.approx(2.0)
    of_lines = (found.total_length_mm, found.tips, found.bushiness, found.angle_to_parent_deg, found.specific_root_length_m_per_g)
    assert of_lines == (None,) * 5
    assert found.length_by_depth_mm == ()


def test_every_trait_is_in_the_table_once():
    named = [d.field for d in DEFINITIONS] + [h.field for h in (*HISTOGRAMS, *PROFILES)]
    assert sorted(named) == sorted(field.name for field in fields(Traits))


def test_bins_have_the_intervals_of_length_and_diameter() -> None:
    found = measure_traits([line([0.0, 0.0, -10.0], [0.0, 0.0, -50.0], 0.55)], BOX, volume_mm3=140.0, surface_mm2=300.0)
    length = Assessment(verdict="not reliable", interval=(36.0, 50.0), codes=("thin_roots",))
    table = to_csv(found, {"total_length_mm": length, "mean_diameter_mm": Assessment(verdict="reliable", interval=(0.55, 0.60))})
    rows = {name: [one.split(",") for one in table.splitlines() if one.startswith(name)] for name in ("length_by_de", "length_by_di")}
    by_depth, by_diameter = ([(*map(float, row[6:8]), *row[8:10]) for row in own] for own in rows.values())
    assert by_depth == [(9.0, 12.5, "not reliable", "thin_roots")] * 4
    # within a bin of 0.1 mm, the length is assumed to be evenly distributed: 0.5 to 0.6 mm become up to 0.545 to 0.655 mm
    assert by_diameter[5] == pytest.approx((36.0 * (0.6 - 0.6 / 0.55 * 0.5) / (0.1 * 0.6 / 0.55), 50.0, "not reliable", "thin_roots"))
    unknown = [one.split(",") for one in to_csv(found, {"total_length_mm": length}).splitlines() if one.startswith("length_by_di")]
    assert {(row[6], row[8]) for row in unknown} == {("", "no interval")}


def rod(plant: str, *ends: tuple[float, float, float], diameter_mm: float = 1.0) -> Root:
    return straight(*ends, diameter_mm, plant=plant)


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


def test_specimens_stand_where_their_plants_hang() -> None:
    assert Plant(plant="A", at_mm=(5.0, -3.0), specimen=GrownSpecimen()).placed() == GrownSpecimen(origin_mm=(5.0, -3.0, -10.5))
    moved = Plant(plant="A", at_mm=(5.0, 0.0), specimen=MeshSpecimen(file="a.stl", shift_mm=(1.0, 0.0, -9.0))).placed()
    assert moved == MeshSpecimen(file="a.stl", shift_mm=(6.0, 0.0, -9.0))
    assert Plant(plant="A").placed() is None
