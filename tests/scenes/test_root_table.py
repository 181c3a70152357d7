"""Table of single roots: hand-computed values of a taproot with two laterals, one of which bears another."""

import csv
import io

import numpy as np
import pytest

from rhizotwin.scenes import root_table
from rhizotwin.scenes.rsml import Root
from rhizotwin.scenes.traits import measure_traits
from tests.roots import straight

BENT = Root(
    points_mm=np.array([[0.0, 0.0, -30.0], [6.0, 0.0, -30.0], [6.0, 0.0, -38.0]]),
    diameters_mm=np.array([0.4, 0.4, 0.2]),
    order=1,
    parent=0,
)
ROOTS = (
    straight((0, 0, -10), (0, 0, -60), (2.0, 1.0)),
    BENT,
    straight((0, 0, -50), (20, 0, -50), order=1, parent=0),
    straight((0, 0, -50), (-10, 0, -60), order=1, parent=0, tip_seen=False),
    straight((6, 0, -34), (6, 8, -34), order=2, parent=1),
)


def test_values_by_hand() -> None:
    tap, bent, level, steep, second = root_table.root_rows(ROOTS)
    assert (tap.parent, tap.length_mm, tap.diameter_mean_mm, tap.tortuosity) == (None, 50.0, pytest.approx(1.5), 1.0)
    assert tap.volume_mm3 == pytest.approx(np.pi / 3.0 * 50.0 * (1.0 + 0.5 + 0.25))
    assert (tap.laterals, tap.lateral_density_per_cm) == (3, pytest.approx(10.0 * 3 / 20.0))
    assert (tap.base_depth_mm, tap.tip_depth_mm, tap.position_mm, tap.next_branch_mm) == (10.0, 60.0, None, None)
    assert (bent.length_mm, bent.tortuosity, bent.diameter_mean_mm) == (14.0, 1.4, pytest.approx((6.0 * 0.4 + 8.0 * 0.3) / 14.0))
    assert (bent.position_mm, bent.next_branch_mm, bent.insertion_angle_deg) == (20.0, 20.0, pytest.approx(90.0))
    assert (level.position_mm, level.next_branch_mm, level.lateral_density_per_cm) == (40.0, None, None)
    assert (steep.insertion_angle_deg, steep.tip_seen) == (pytest.approx(45.0), False)
    assert (second.root, second.parent, second.order, second.laterals) == (5, 2, 2, 0)


def test_traits_of_the_whole_system() -> None:
    found = measure_traits(ROOTS, np.concatenate([root.points_mm for root in ROOTS]), volume_mm3=1.0, surface_mm2=1.0)
    lengths, direct = 50.0 + 14.0 + 20.0 + 200.0**0.5 + 8.0, 50.0 + 10.0 + 20.0 + 200.0**0.5 + 8.0
    assert found.tortuosity == pytest.approx(lengths / direct)
    assert (found.branch_distance_mm, found.lateral_density_per_cm) == (10.0, pytest.approx(1.5))
    alone = measure_traits(ROOTS[:1], ROOTS[0].points_mm, volume_mm3=1.0, surface_mm2=1.0)
    assert (alone.tortuosity, alone.branch_distance_mm, alone.lateral_density_per_cm) == (1.0, None, None)


def test_csv_has_empty_cells_for_unknown_values() -> None:
    rows = list(csv.DictReader(io.StringIO(root_table.to_csv(ROOTS, verdict="reliable"))))
    assert [row["parent"] for row in rows] == ["", "1", "1", "1", "2"]
    assert [row["tip_seen"] for row in rows] == ["yes", "yes", "yes", "no", "yes"]
    assert {row["verdict"] for row in rows} == {"reliable"}
    assert (rows[0]["next_branch_mm"], rows[1]["length_mm"]) == ("", "14")
