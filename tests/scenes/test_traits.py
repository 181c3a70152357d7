"""Traits of small root systems that can be counted by hand, and their tables."""

import csv
import io
from dataclasses import fields, replace

import numpy as np
import pytest

from rhizotwin.scenes.rsml import Root
from rhizotwin.scenes.trait_table import DEFINITIONS, HISTOGRAMS, to_csv
from rhizotwin.scenes.traits import Traits, measure_traits

RNG = np.random.default_rng(0)


def line(start, end, diameter_mm, *, order=0, parent=-1, count=41) -> Root:
    share = np.linspace(0.0, 1.0, count)[:, None]
    points = np.asarray(start) * (1.0 - share) + np.asarray(end) * share
    return Root(points_mm=points, diameters_mm=np.full(count, float(diameter_mm)), order=order, parent=parent)


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
    assert (found.roots, found.tips, found.branch_points) == (3, 3, 1)
    assert found.depth_mm == pytest.approx(40.0)
    assert found.width_mm == pytest.approx(np.hypot(35.0, 2.0))
    assert found.convex_hull_mm3 == pytest.approx(35.0 * 2.0 * 40.0)
    assert found.solidity == pytest.approx(140.0 / 2800.0)
    assert found.length_by_order_mm == pytest.approx((40.0, 20.0 + slanted))
    assert found.length_by_depth_mm == pytest.approx((10.0, 10.0 + 20.0 + 10.0 * np.sqrt(2.0), 10.0 + 5.0 * np.sqrt(2.0), 10.0))
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
    named = [d.field for d in DEFINITIONS] + [h.field for h in HISTOGRAMS]
    assert sorted(named) == sorted(field.name for field in fields(Traits))


def test_csv_has_a_row_a_trait_and_a_row_a_bin():
    root = line([0.0, 0.0, 0.0], [0.0, 0.0, -25.0], 0.35, count=2)
    traits = measure_traits([root], root.points_mm, volume_mm3=2.5, surface_mm2=27.0, mass_g=0.005)
    rows = list(csv.DictReader(io.StringIO(to_csv(traits, {}))))
    by_name = {row["trait"]: row for row in rows if not row["bin_to"]}
    assert (by_name["total_length_mm"]["value"], by_name["total_length_mm"]["unit"]) == ("25", "mm")
    assert float(by_name["specific_root_length_m_per_g"]["value"]) == pytest.approx(5.0)
    depth = [(row["bin_from"], row["bin_to"], row["value"]) for row in rows if row["trait"] == "length_by_depth_mm"]
    assert depth == [("0", "10", "10"), ("10", "20", "10"), ("20", "30", "5")]
