"""Random scans have the disturbances, views and subjects that their number draws, and no others."""

from dataclasses import fields

import pytest

from benchmarks import random_scans
from benchmarks.random_scans import AGE, PROFILES, SIGNED, TROUBLES, VIEWS, RandomScan
from rhizotwin.scenes.disturbances import Disturbances
from rhizotwin.scenes.files import load_profile, load_scene
from rhizotwin.scenes.specimens import GrownSpecimen


@pytest.mark.parametrize("number", [5, 11, 17, 23, 29, 35])
def test_a_mixture_has_its_troubles_and_no_others(number: int) -> None:
    mixture, camera, real = RandomScan(number=number), load_profile("camera"), load_profile("real")
    wrong = mixture.scene_to_render().disturbances
    assert wrong == mixture.scene_to_render().disturbances
    for trouble, names in TROUBLES.items():
        for name in names:
            value, most = getattr(wrong, name), getattr(real, name)
            if trouble in mixture.troubles():
                assert 0.2 * most <= abs(value) <= 1.51 * most + 1.0
                assert value >= 0 or name in SIGNED
            else:
                assert value == getattr(camera, name)


def test_a_mixture_may_contain_all_that_real_adds_to_camera() -> None:
    camera, real = load_profile("camera"), load_profile("real")
    for number, profile in enumerate(PROFILES[:-1]):
        assert RandomScan(number=number).scene_to_render().disturbances == load_profile(profile)
    mixed = {name for names in (*TROUBLES.values(), *random_scans.WITH.values()) for name in names}
    assert mixed == {one.name for one in fields(Disturbances) if getattr(camera, one.name) != getattr(real, one.name)}


def test_the_draw_covers_families_sizes_and_rings_in_range() -> None:
    scans = [RandomScan(number=number) for number in range(300)]
    assert {scan.family for scan in scans} == set(random_scans.FAMILIES)
    assert {scan.image_wh for scan in scans} == set(random_scans.SIZES)
    assert {len(scan.rings()) for scan in scans} == {1, 2}
    assert all(VIEWS[0] <= sum(ring.views for ring in scan.rings()) <= VIEWS[1] + 1 for scan in scans)


def test_plants_differ_from_the_library_in_seed_and_age() -> None:
    seen = 0
    for number in range(60):
        scan = RandomScan(number=number)
        specimen = scan.scene_to_render().specimen
        if scan.family in ("bean", "maize", "wheat", "carrot", "bulb"):
            own = load_scene(scan.family).specimen
            assert isinstance(specimen, GrownSpecimen)
            assert isinstance(own, GrownSpecimen)
            assert specimen.seed != own.seed
            assert AGE[0] <= specimen.age_days / own.age_days <= AGE[1]
            seen += 1
    assert seen > 5
