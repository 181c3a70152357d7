"""Blades told from stalks on closed surfaces whose parts are known."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from rhizotwin.recon.shoots import blades
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.shoots import Shoot as Plant
from rhizotwin.sim.shoot import build_shoot


def blade(at_mm: tuple[float, float, float], *, width_mm: float = 16.0) -> trimesh.Trimesh:
    return trimesh.creation.box((30.0, width_mm, 0.5)).apply_translation(at_mm)


def test_blades_that_touch_are_one_and_a_stalk_is_none() -> None:
    stalk = trimesh.creation.cylinder(radius=1.2, height=40.0, sections=32)
    found = blades.find_blades(trimesh.util.concatenate([stalk, blade((15.0, 0.0, 24.0)), blade((-15.0, 0.0, -24.0), width_mm=10.0)]))
    assert found.areas_mm2 == pytest.approx((30.0 * 16.5, 30.0 * 10.5), rel=0.05)  # and half of their sides
    assert found.near(np.array([[0.0, 0.0, 0.0], [20.0, 0.0, 24.0]])).tolist() == [False, True]
    assert len(blades.find_blades(trimesh.util.concatenate([blade((0.0, 0.0, 0.0)), blade((29.0, 0.0, 0.3))])).areas_mm2) == 1
    alone = blades.find_blades(stalk)
    assert alone.areas_mm2 == ()
    assert alone.area_mm2 < 0.1 * 0.5 * stalk.area


def test_a_grown_shoot_has_its_leaves_and_their_area() -> None:
    solid = build_shoot(replace(Scene(), shoot=Plant(seed=3, leaves=6)))
    assert solid is not None
    found = blades.find_blades(trimesh.Trimesh(solid.vertices, solid.faces, process=False))
    assert len(found.areas_mm2) == 6
    assert found.area_mm2 == pytest.approx(solid.leaf_area_mm2, rel=0.07)
