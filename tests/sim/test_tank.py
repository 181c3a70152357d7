"""The twin's tank: Mitsuba's own dielectrics and the reconstruction's closed form see a ball in the same place."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from rhizotwin.recon.optics.cameras import View, project_through_tank
from rhizotwin.recon.optics.refraction import Optics
from rhizotwin.scenes import frames
from rhizotwin.scenes.disturbances import Disturbances
from rhizotwin.scenes.model import CapturePlan, Ring, Scene, Tank
from rhizotwin.sim.render import Renderer
from rhizotwin.sim.world import draw_world
from tests.sim.test_optics import check_place

CLEAN = Disturbances()


@dataclass(frozen=True)
class Case:
    """A ball, and what is wrong with the rig."""

    name: str
    centre_mm: tuple[float, float, float]
    view: int = 0
    liquid: float = 1.333
    turn_deg: float = 0.0
    wrong: Disturbances = CLEAN


CASES = (
    Case("near the axis", (3.0, 2.0, -60.0)),
    Case("beside, where the round canister alone is blind", (0.0, 66.0, -80.0)),
    Case("another liquid", (-30.0, 40.0, -100.0), liquid=1.38),
    Case("a turned tank", (-20.0, 45.0, -90.0), turn_deg=3.0),
    Case(
        "everything misplaced",
        (20.0, -60.0, -70.0),
        view=2,
        wrong=Disturbances(arm_deg=0.3, arm_mm=1.0, table_deg=0.1, canister_offset_mm=1.0, canister_tilt_deg=0.5),
    ),
)


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_a_ball_is_seen_where_the_closed_form_says(case: Case) -> None:
    scene = Scene(
        plan=CapturePlan(rings=(Ring(views=5),)), tank=Tank(n_liquid=case.liquid, turn_deg=case.turn_deg), disturbances=case.wrong
    )
    camera = draw_world(scene, seed=4).cameras[case.view]
    turned = frames.rotation_z(np.deg2rad(case.turn_deg))
    cam_from_tank = camera.cam_from_canister @ frames.invert(camera.rig_from_canister) @ turned
    view = View(camera=scene.camera, cam_from_canister=camera.cam_from_canister, cam_from_tank=cam_from_tank)
    expected, seen, _ = project_through_tank(view, Optics.from_scene(scene), np.array([case.centre_mm]))
    assert seen.all()
    check_place(scene, expected[0], case.centre_mm, view=case.view, atol_px=2e-3)


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
