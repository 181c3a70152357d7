"""The twin's tank: Mitsuba's own dielectrics and the reconstruction's closed form see a ball in the same place."""

from dataclasses import replace

import numpy as np
import pytest

from rhizotwin.recon.optics.cameras import View, project_through_tank
from rhizotwin.recon.optics.refraction import Optics
from rhizotwin.scenes import frames
from rhizotwin.scenes.disturbances import Disturbances
from rhizotwin.scenes.model import CapturePlan, Ring, Scene, Tank
from rhizotwin.sim.render import Renderer
from rhizotwin.sim.world import draw_world
from tests.sim.test_optics import MISPLACED, check_place

CASES = {
    "beside, in another liquid": ((0.0, 66.0, -80.0), 0, Tank(n_liquid=1.38), Disturbances()),
    "a turned tank": ((-20.0, 45.0, -90.0), 0, Tank(turn_deg=3.0), Disturbances()),
    "everything misplaced": ((20.0, -60.0, -70.0), 2, Tank(), MISPLACED),
}


@pytest.mark.parametrize(("centre_mm", "number", "tank", "wrong"), CASES.values(), ids=CASES)
def test_a_ball_is_seen_where_the_closed_form_says(
    centre_mm: tuple[float, float, float], number: int, tank: Tank, wrong: Disturbances
) -> None:
    scene = Scene(plan=CapturePlan(rings=(Ring(views=5),)), tank=tank, disturbances=wrong)
    camera = draw_world(scene, seed=4).cameras[number]
    cam_from_tank = camera.cam_from_canister @ frames.invert(camera.rig_from_canister) @ frames.rotation_z(np.deg2rad(tank.turn_deg))
    view = View(camera=scene.camera, cam_from_canister=camera.cam_from_canister, cam_from_tank=cam_from_tank)
    expected, seen, _ = project_through_tank(view, Optics.from_scene(scene), np.array([centre_mm]))
    assert seen.all()
    check_place(scene, expected[0], centre_mm, view=number, atol_px=2e-3)


def test_the_empty_tank_passes_the_panel_and_keeps_the_strip_dry() -> None:
    scene = replace(Scene(tank=Tank(), plan=CapturePlan(rings=(Ring(views=1),))), camera=Scene().camera.resized((100, 75)))
    light, coverage = Renderer(scene, draw_world(scene, seed=0), None, samples=4).view(0)
    open_air = replace(scene, tank=None)
    bare, _ = Renderer(open_air, draw_world(open_air, seed=0), None, samples=4).view(0)
    assert not coverage.any()
    glass, wet = (1.0 - ((1.49 - n) / (1.49 + n)) ** 2 for n in (1.0, 1.333))  # Fresnel, normal incidence
    # through two walls of the tank, air and liquid, and twice through the canister's, liquid and water
    assert light[37, 49:51].mean() == pytest.approx(scene.lights.backlight_level * glass**2 * wet**6, rel=2e-3)
    assert np.abs(light[:16] - bare[:16]).max() < 1e-3  # above the liquid nothing is changed
