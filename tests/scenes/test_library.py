"""The scenes and profiles that come with the program."""

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


def test_the_library_is_complete_and_each_scene_loads_under_its_name() -> None:
    solids = ["sphere_20mm", "printed_8ml", "fallen_plant", "gel_cylinder", "print_in_tank", "radish_shoot", "two_radishes"]
    assert sorted(name for name, _ in library()) == sorted([*solids, *FAMILIES, *RADISHES])
    for name, description in library():
        scene = load_scene(name)
        assert (scene.name, scene.description) == (name, description)
        assert description.strip(), name
        assert "\n" not in description, name
        assert scene.disturbances == Disturbances(), name
    assert load_scene("radish_day15") == load_scene("radish_day15a")


def test_radishes_have_the_volumes_names_and_days_of_the_thesis() -> None:
    scenes = [load_scene(name) for name in RADISHES]
    assert [scene.specimen.volume_ml for scene in scenes] == WET_ROOT_G
    assert len({scene.specimen.seed for scene in scenes}) == len(RADISHES)
    assert [scene.subject.plant for scene in scenes] == [f"radish {number}" for number in range(1, 19)]
    assert [scene.subject.day for scene in scenes] == [5.0 * (1 + k // 3) for k in range(18)]


def test_printed_root_and_sphere() -> None:
    printed = load_scene("printed_8ml").specimen
    assert isinstance(printed, GrownSpecimen)
    assert printed.volume_ml == 8.0
    assert load_scene("sphere_20mm").specimen == SphereSpecimen(diameter_mm=20.0, centre_mm=(0.0, 0.0, -55.0))


def test_profiles_are_listed_mildest_first() -> None:
    assert [name for name, _ in profiles()] == ["clean", "bench", "camera", "harsh", "real"]
    assert all(description for _, description in profiles())
    assert load_profile("clean") == Disturbances()


def test_bench_is_what_was_agreed_and_harsh_is_more() -> None:
    bench, harsh = load_profile("bench"), load_profile("harsh")
    assert (bench.arm_deg, bench.table_deg, bench.canister_offset_mm, bench.canister_tilt_deg) == (0.3, 0.05, 1.0, 0.5)
    assert bench.n_water_error == 0.001
    assert bench.full_well_e is not None
    assert min(bench.read_noise_e, bench.aperture_mm, bench.backlight_unevenness, abs(bench.distortion[0])) > 0.0
    for name in ("full_well_e", "read_noise_e", "aperture_mm", "distortion", "arm_deg", "table_deg", "canister_tilt_deg", "n_water_error"):
        assert getattr(harsh, name) == getattr(bench, name)
    more = ("algae_patches", "felt_fibres", "bubbles", "turbidity_per_mm", "strip_offset_mm", "strip_tilt_deg")
    assert [name for name in more if getattr(bench, name) != 0.0 or getattr(harsh, name) <= 0.0] == []
    assert bench.root_mu_per_mm is None
    assert harsh.root_mu_per_mm is not None


def test_bench_blur_is_about_a_pixel_over_the_canister() -> None:
    bench, scene = load_profile("bench"), load_scene("sphere_20mm")
    distance = scene.plan.rings[0].distance_mm
    focus = distance + bench.focus_error_mm
    for d in (distance - scene.canister.inner_radius_mm, distance + scene.canister.inner_radius_mm):
        assert scene.camera.focal_px[0] * bench.aperture_mm * abs(1.0 / d - 1.0 / focus) < 1.0
