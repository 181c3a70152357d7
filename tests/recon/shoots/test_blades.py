"""Blades told from stalks on closed surfaces whose parts are known."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from rhizotwin.recon.shoots import blades
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.shoots import Shoot as Plant
from rhizotwin.sim.shoot import build_shoot


def blade(at_mm: tuple[float, float, float], *, length_mm: float = 30.0, width_mm: float = 16.0) -> trimesh.Trimesh:
    box = trimesh.creation.box((length_mm, width_mm, 0.5))
    box.apply_translation(at_mm)
    return box


def stalk(length_mm: float = 40.0) -> trimesh.Trimesh:
    return trimesh.creation.cylinder(radius=1.2, height=length_mm, sections=32)


def test_two_blades_on_a_stalk_are_two_and_the_stalk_is_none() -> None:
    found = blades.find(trimesh.util.concatenate([stalk(), blade((15.0, 0.0, 24.0)), blade((-15.0, 0.0, -24.0), width_mm=10.0)]))
    assert len(found.areas_mm2) == 2
    assert found.areas_mm2[0] == pytest.approx(30.0 * 16.5, rel=0.05)  # and half of its sides
    assert found.areas_mm2[1] == pytest.approx(30.0 * 10.5, rel=0.05)
    assert found.near(np.array([[0.0, 0.0, 0.0], [20.0, 0.0, 24.0]])).tolist() == [False, True]


def test_blades_that_touch_are_one() -> None:
    found = blades.find(trimesh.util.concatenate([blade((0.0, 0.0, 0.0)), blade((29.0, 0.0, 0.3))]))
    assert len(found.areas_mm2) == 1


def test_a_stalk_has_no_blade() -> None:
    found = blades.find(stalk())
    assert found.areas_mm2 == ()
    assert found.area_mm2 < 0.1 * 0.5 * stalk().area


@pytest.mark.parametrize("leaves", [3, 6])
def test_a_grown_shoot_has_its_leaves_and_their_area(leaves: int) -> None:
    solid = build_shoot(replace(Scene(), shoot=Plant(seed=3, leaves=leaves)))
    assert solid is not None
    found = blades.find(trimesh.Trimesh(solid.vertices, solid.faces, process=False))
    assert len(found.areas_mm2) == leaves
    assert found.area_mm2 == pytest.approx(solid.leaf_area_mm2, rel=0.07)
