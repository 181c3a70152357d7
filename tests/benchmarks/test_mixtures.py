"""The drawn scans are what they say."""

from dataclasses import fields

import pytest

from benchmarks import mixtures
from benchmarks.mixtures import SIGNED, TROUBLES, Mixture
from rhizotwin.scenes.files import load_profile
from rhizotwin.scenes.model import Disturbances


@pytest.mark.parametrize("number", [2, 7, 12, 17, 22, 27])
def test_a_mixture_has_its_troubles_and_no_others(number: int) -> None:
    mixture, camera, real = Mixture(number=number), load_profile("camera"), load_profile("real")
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


def test_profiles_come_as_they_are_and_all_that_real_adds_to_camera_is_mixed() -> None:
    camera, real = load_profile("camera"), load_profile("real")
    assert Mixture(number=0).scene_to_render().disturbances == camera
    assert Mixture(number=6).scene_to_render().disturbances == real
    mixed = {name for names in (*TROUBLES.values(), *mixtures.WITH.values()) for name in names}
    assert mixed == {one.name for one in fields(Disturbances) if getattr(camera, one.name) != getattr(real, one.name)}
