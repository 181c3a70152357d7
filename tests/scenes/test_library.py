"""The scenes and profiles that come with the program."""

import pytest

from rhizotwin.scenes.files import library, load_profile, load_scene, profiles
from rhizotwin.scenes.model import Disturbances
from rhizotwin.scenes.specimens import GrownSpecimen, SphereSpecimen

# Wet root masses in g of radish 1 to 18 (thesis, table A.1), three an age: days 5, 10, ... 30; taken as ml at 1.0 g/ml.
WET_ROOT_G = [
    0.0348, 0.0585, 0.0625, 0.1192, 0.2399, 0.2618, 0.3329, 0.1478, 0.1869,
    0.956, 0.9287, 0.5903, 1.7722, 0.6957, 1.1488, 1.18, 0.3414, 1.7325,
]  # fmt: skip
RADISHES = [f"radish_day{day:02d}{plant}" for day in range(5, 31, 5) for plant in "abc"]

FAMILIES = ["bean", "maize", "wheat", "lettuce", "bulb", "carrot", "radish_swollen"]


def test_the_library_is_complete() -> None:
    solids = ["sphere_20mm", "printed_8ml", "fallen_plant", "gel_cylinder", "print_in_tank", "radish_shoot", "two_radishes"]
    assert sorted(name for name, _ in library()) == sorted([*solids, *FAMILIES, *RADISHES])


@pytest.mark.parametrize("name", [name for name, _ in library()])
def test_library_scene_loads_under_its_name(name: str) -> None:
    scene = load_scene(name)
    assert scene.name == name
    assert scene.description == dict(library())[name]
    assert scene.description.strip()
    assert "\n" not in scene.description
    assert scene.disturbances == Disturbances()


def test_radishes_have_the_volumes_of_the_thesis() -> None:
    specimens = [load_scene(name).specimen for name in RADISHES]
    assert [s.volume_ml for s in specimens if isinstance(s, GrownSpecimen)] == WET_ROOT_G
    assert len({s.seed for s in specimens if isinstance(s, GrownSpecimen)}) == len(RADISHES)


def test_printed_root_and_sphere() -> None:
    printed = load_scene("printed_8ml").specimen
    assert isinstance(printed, GrownSpecimen)
    assert printed.volume_ml == 8.0
    assert load_scene("sphere_20mm").specimen == SphereSpecimen(diameter_mm=20.0, centre_mm=(0.0, 0.0, -55.0))


def test_age_without_a_plant_means_plant_a() -> None:
    assert load_scene("radish_day15") == load_scene("radish_day15a")


def test_profiles_are_listed_mildest_first() -> None:
    assert [name for name, _ in profiles()] == ["clean", "bench", "camera", "harsh", "real"]
    assert all(description for _, description in profiles())


def test_clean_is_perfect() -> None:
    assert load_profile("clean") == Disturbances()


def test_bench_is_what_was_asked_for() -> None:
    bench = load_profile("bench")
    assert (bench.arm_deg, bench.table_deg, bench.canister_offset_mm, bench.canister_tilt_deg) == (0.3, 0.05, 1.0, 0.5)
    assert bench.n_water_error == 0.001
    assert bench.full_well_e is not None
    assert min(bench.read_noise_e, bench.aperture_mm, bench.backlight_unevenness, abs(bench.distortion[0])) > 0.0
    assert bench.root_mu_per_mm is None
    assert bench.strip_offset_mm == bench.strip_tilt_deg == bench.turbidity_per_mm == 0.0
    assert bench.algae_patches == bench.felt_fibres == bench.bubbles == 0


def test_bench_blur_is_about_a_pixel_over_the_canister() -> None:
    bench, scene = load_profile("bench"), load_scene("sphere_20mm")
    distance = scene.plan.rings[0].distance_mm
    focus = distance + bench.focus_error_mm
    for d in (distance - scene.canister.inner_radius_mm, distance + scene.canister.inner_radius_mm):
        assert scene.camera.focal_px[0] * bench.aperture_mm * abs(1.0 / d - 1.0 / focus) < 1.0


def test_harsh_is_bench_and_more() -> None:
    bench, harsh = load_profile("bench"), load_profile("harsh")
    for name in ("full_well_e", "read_noise_e", "aperture_mm", "distortion", "arm_deg", "table_deg", "canister_tilt_deg", "n_water_error"):
        assert getattr(harsh, name) == getattr(bench, name)
    assert harsh.root_mu_per_mm is not None
    assert min(harsh.algae_patches, harsh.felt_fibres, harsh.bubbles) > 0
    assert min(harsh.algae_opacity, harsh.turbidity_per_mm, harsh.strip_offset_mm, harsh.strip_tilt_deg) > 0.0
