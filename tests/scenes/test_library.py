"""The scenes and profiles that come with the program."""

import pytest

from rhizotwin.scenes.disturbances import Disturbances
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.files import library, load_scene

# Wet root masses in g of radish 1 to 18 (thesis, table A.1), three an age: days 5, 10, ... 30; taken as ml at 1.0 g/ml.
WET_ROOT_G = [
    0.0348, 0.0585, 0.0625, 0.1192, 0.2399, 0.2618, 0.3329, 0.1478, 0.1869,
    0.956, 0.9287, 0.5903, 1.7722, 0.6957, 1.1488, 1.18, 0.3414, 1.7325,
]  # fmt: skip
RADISHES = [f"radish_day{day:02d}{plant}" for day in range(5, 31, 5) for plant in "abc"]

FAMILIES = ["bean", "maize", "wheat", "lettuce", "bulb", "carrot", "radish_swollen"]


def test_the_library_is_complete_and_each_scene_has_its_name() -> None:
    listed = list(library())
    assert {"sphere_20mm", "printed_8ml", *FAMILIES, *RADISHES} < {name for name, _ in listed}
    scenes = [load_scene(name) for name, _ in listed]
    assert [(scene.name, scene.description) for scene in scenes] == listed
    assert all(text.strip() and "\n" not in text for _, text in listed)
    assert {scene.disturbances for scene in scenes} == {Disturbances()}
    with pytest.raises(UserError, match=r"ambiguous; choose radish_day15a, radish_day15b, radish_day15c$"):
        load_scene("radish_day15")


def test_radishes_have_the_volumes_names_and_days_of_the_thesis() -> None:
    scenes = [load_scene(name) for name in RADISHES]
    assert [scene.specimen.volume_ml for scene in scenes] == WET_ROOT_G
    assert len({scene.specimen.seed for scene in scenes}) == len(RADISHES)
    assert [scene.subject.plant for scene in scenes] == [f"radish {number}" for number in range(1, 19)]
    assert [scene.subject.day for scene in scenes] == [5.0 * (1 + k // 3) for k in range(18)]
