"""Growth: laws with closed forms, reproducibility, and roots that stay where the water is."""

from dataclasses import replace

import numpy as np
import pytest

from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Canister, NetPot
from rhizotwin.scenes.polyline import length_mm
from rhizotwin.scenes.specimens import BasalRoots, GrownSpecimen, RootOrder
from rhizotwin.sim import elongation, growth

STRAIGHT = RootOrder(
    diameter_mm=1.0, diameter_sd=0.0, taper=0.5, elongation_mm_per_day=10.0, max_length_mm=80.0, length_sd=0.0, interlateral_mm=6.0,
    interlateral_sd=0.0, base_mm=5.0, apex_mm=10.0, insertion_deg=60.0, insertion_sd_deg=0.0, gravitropism_per_mm=0.0, wobble_deg=0.0,
)  # fmt: skip
LIVELY = replace(STRAIGHT, wobble_deg=10.0, length_sd=0.3, interlateral_sd=0.5, insertion_sd_deg=10.0, gravitropism_per_mm=0.01)


def test_a_straight_taproot_follows_the_law_of_elongation() -> None:
    roots = growth.grow(GrownSpecimen(age_days=8.0, orders=(STRAIGHT,)))
    expected_mm = 80.0 * (1.0 - np.exp(-10.0 * 8.0 / 80.0))
    assert len(roots) == 1
    assert roots[0].points_mm[-1] == pytest.approx([0.0, 0.0, -10.5 - expected_mm], abs=1e-9)
    assert roots[0].diameters_mm[[0, -1]] == pytest.approx([1.0, 0.5])


def test_laterals_are_where_distance_angle_and_apex_say() -> None:
    roots = growth.grow(GrownSpecimen(age_days=8.0, orders=(STRAIGHT, STRAIGHT)))
    taproot, laterals = roots[0], roots[1:]
    starts_mm = np.array([-10.5 - root.points_mm[0, 2] for root in laterals])
    assert starts_mm == pytest.approx(5.0 + 6.0 * np.arange(1, len(laterals) + 1))
    assert starts_mm.max() < length_mm(taproot.points_mm) - 10.0 < starts_mm.max() + 8.0
    for root in laterals:
        along = root.points_mm[1] - root.points_mm[0]
        assert np.degrees(np.arccos(-along[2] / np.linalg.norm(along))) == pytest.approx(60.0, abs=1e-6)
        assert root.parent == 0
        assert root.order == 1
    lengths_mm = [length_mm(root.points_mm) for root in laterals]
    assert lengths_mm == sorted(lengths_mm, reverse=True)  # acropetal: the oldest is nearest the base
    born_days = elongation.age_at(starts_mm + 10.0, max_length_mm=np.array(80.0), elongation_mm_per_day=np.array(10.0))
    expected_mm = elongation.length_at(8.0 - born_days, max_length_mm=np.array(80.0), elongation_mm_per_day=np.array(10.0))
    assert lengths_mm == pytest.approx(expected_mm, abs=1e-6)


def test_gravitropism_bends_as_its_equation_says() -> None:
    """d(theta)/ds = -k sin(theta) has the solution tan(theta / 2) = tan(theta0 / 2) exp(-k s)."""
    lateral = replace(STRAIGHT, gravitropism_per_mm=0.02, max_length_mm=55.0, elongation_mm_per_day=100.0)
    taproot = replace(STRAIGHT, interlateral_mm=20.0, elongation_mm_per_day=100.0)
    root = growth.grow(GrownSpecimen(age_days=20.0, orders=(taproot, lateral)))[1]
    along = np.diff(root.points_mm, axis=0)[:45]
    theta = np.arccos(-along[:, 2] / np.linalg.norm(along, axis=1))
    s_mm = np.arange(1, 46)
    expected = 2.0 * np.arctan(np.tan(np.radians(60.0) / 2.0) * np.exp(-0.02 * s_mm))
    assert theta == pytest.approx(expected, abs=0.01)


def test_a_tilted_plant_turns_down_and_its_tip_circles() -> None:
    """The path before the tilt remains; then the equation above holds. Nutation adds a circle around this path."""
    order = replace(STRAIGHT, gravitropism_per_mm=0.1, max_length_mm=1e6)
    tilted = GrownSpecimen(age_days=3.0, orders=(order,), lean_deg=60.0, lean_until_days=2.0, step_mm=0.05)
    path = growth.grow(tilted)[0].points_mm
    along = np.diff(path, axis=0)[:-1] / 0.05
    assert np.degrees(np.arccos(-along[:399, 2])) == pytest.approx(60.0)
    expected = 2.0 * np.arctan(np.tan(np.radians(60.0) / 2.0) * np.exp(-0.1 * 10.0))
    assert np.arccos(-along[-1, 2]) == pytest.approx(expected, abs=0.01)
    before = np.zeros(3)
    for hours in (0.0, 1.0, 2.0, 3.0):
        now = replace(tilted, age_days=3.0 + hours / 24.0)
        straight, circling = (
            growth.grow(replace(now, orders=(replace(order, nutation_mm=mm, nutation_h=4.0),)))[0].points_mm for mm in (0.0, 0.5)
        )
        away = circling[-1] - straight[-1]
        assert np.linalg.norm(away) == pytest.approx(0.5, abs=0.01)
        assert np.array_equal(circling[:500], straight[:500])  # above the growth zone
        assert np.cross(before, away)[2] > 0.0 or hours == 0.0  # counter-clockwise seen from above
        before = away


def test_wobble_spreads_headings_by_the_root_of_length() -> None:
    """Heading variance of a persistent walk: w^2 (s - l (1 - exp(-s / l))) for each of the two angles, l the persistence."""
    order = replace(STRAIGHT, wobble_deg=3.0, elongation_mm_per_day=1000.0, max_length_mm=40.0, diameter_mm=0.1)
    headings = []
    for seed in range(150):
        points_mm = growth.grow(GrownSpecimen(seed=seed, age_days=10.0, orders=(order,)))[0].points_mm
        last = points_mm[30] - points_mm[29]
        headings.append(last[:2] / np.linalg.norm(last))
    expected_deg = 3.0 * np.sqrt(30.0 - 4.0 * (1.0 - np.exp(-30.0 / 4.0)))
    assert np.degrees(np.std(np.arcsin(headings))) == pytest.approx(expected_deg, rel=0.12)


def test_an_older_plant_continues_and_a_root_ignores_neighbours() -> None:
    orders = (LIVELY, LIVELY, LIVELY)
    young = growth.grow(GrownSpecimen(seed=2, age_days=7.0, orders=orders))
    old = {root.label: root for root in growth.grow(GrownSpecimen(seed=2, age_days=9.0, orders=orders))}
    assert len(old) > len(young)
    for root in young:
        same = max(len(root.points_mm) - 3, 1)
        assert old[root.label].points_mm[:same] == pytest.approx(root.points_mm[:same], abs=1e-9)
    for root in growth.grow(GrownSpecimen(seed=2, age_days=9.0, orders=orders[:2])):
        assert np.array_equal(old[root.label].points_mm, root.points_mm)


@pytest.mark.parametrize("lean_deg", [0.0, 90.0], ids=["down", "to the wall"])
def test_roots_stay_in_the_water_and_turn_smoothly(lean_deg: float) -> None:
    """A canister so small that every root meets wall and floor."""
    canister, net_pot = Canister(outer_radius_mm=25.0, height_mm=60.0), NetPot()
    long = replace(LIVELY, max_length_mm=150.0, elongation_mm_per_day=60.0, wobble_deg=6.0)
    specimen = GrownSpecimen(seed=1, orders=(long, long), lean_deg=lean_deg, lean_azimuth_deg=30.0, wall_margin_mm=0.5)
    roots = growth.grow(specimen, canister=canister, net_pot=net_pot)
    wall_reached = floor_reached = False
    for root in roots:
        radius_mm, z_mm = np.hypot(*root.points_mm[:, :2].T), root.points_mm[:, 2]
        half_mm = root.diameters_mm / 2.0
        wall_mm, floor_mm = canister.inner_radius_mm - 0.5, canister.floor_z_mm + 0.5
        assert np.all(radius_mm + half_mm <= wall_mm + 1e-9)
        assert np.all(z_mm - half_mm >= floor_mm - 1e-9)
        assert np.all(z_mm + half_mm <= net_pot.grid_z_mm - 0.5 + 1e-9)
        wall_reached |= bool(np.any(radius_mm + half_mm > wall_mm - 1.0))
        floor_reached |= bool(np.any(z_mm - half_mm < floor_mm + 1.0))
        along = np.diff(root.points_mm[:-1], axis=0)
        step_mm = np.linalg.norm(along, axis=1)
        assert np.all(step_mm > 0.5)  # no root stops at the wall
        bend = np.sum(along[1:] * along[:-1], axis=1) / (step_mm[1:] * step_mm[:-1])
        assert np.degrees(np.arccos(np.clip(bend, -1.0, 1.0))).max() < 75.0
    assert wall_reached
    assert floor_reached


def test_impossible_plants_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(growth, "MOST_ROOTS", 100)
    with pytest.raises(UserError, match=r"origin_mm .* is too close to the edge"):
        growth.grow(GrownSpecimen(origin_mm=(0.0, 0.0, -8.1)))
    crowded = replace(LIVELY, interlateral_mm=0.1, max_length_mm=500.0, elongation_mm_per_day=100.0)
    with pytest.raises(UserError, match="more than 100 roots"):
        growth.grow(GrownSpecimen(age_days=30.0, orders=(crowded, crowded, crowded)))


def test_basal_roots_begin_in_their_zone_and_bear_laterals() -> None:
    basal = BasalRoots(**{**vars(STRAIGHT), "insertion_deg": 50.0}, count=5, at_mm=2.0, zone_mm=4.0, delay_days=1.0)
    thick = GrownSpecimen(age_days=8.0, orders=(STRAIGHT, STRAIGHT), basal=(basal,), hypocotyl_diameter_mm=6.0, buried_mm=1.0)
    thick, wide = replace(thick, origin_mm=(0.0, 0.0, -12.5)), Canister(outer_radius_mm=300.0, height_mm=500.0)
    roots = growth.grow(thick, canister=wide)
    own = [root for root in roots if root.label.startswith("1.10000")]
    assert [root.order for root in own].count(1) == 5
    assert any(root.order == 2 for root in own)
    for number, root in enumerate(root for root in own if root.order == 1):
        assert root.points_mm[0, 2] == pytest.approx(-12.5 - 2.0 - 4.0 * (number + 0.5) / 5.0)
        tap = np.interp(-root.points_mm[0, 2], -roots[0].points_mm[:, 2], roots[0].diameters_mm)
        assert np.hypot(*root.points_mm[0, :2]) == pytest.approx(tap / 2.0 - 1.0, abs=1e-6)  # so deep below the surface
        assert length_mm(root.points_mm) == pytest.approx(80.0 * (1.0 - np.exp(-10.0 * 7.0 / 80.0)), abs=1e-6)
    plain = {root.label: root for root in growth.grow(replace(thick, basal=()), canister=wide)}
    assert all(np.array_equal(root.points_mm, plain[root.label].points_mm) for root in roots if root.label in plain)


def test_a_globe_has_an_ellipsoid_s_volume() -> None:
    tap = replace(STRAIGHT, diameter_mm=0.2, taper=1.0)
    bulb = GrownSpecimen(
        orders=(tap,), origin_mm=(0.0, 0.0, -20.0), hypocotyl_diameter_mm=16.0, hypocotyl_length_mm=20.0, hypocotyl_shape="globe"
    )
    (root,) = growth.grow(bulb)
    along = -20.0 - root.points_mm[:, 2]
    area = np.pi / 4.0 * np.where(along < 20.0, root.diameters_mm, 0.0) ** 2
    assert np.trapezoid(area, along) == pytest.approx(np.pi / 6.0 * 16.0 * 16.0 * 20.0, rel=0.01)
