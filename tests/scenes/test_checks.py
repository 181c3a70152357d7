"""Parts of a scene that do not fit each other are refused."""

from dataclasses import replace
from typing import Any

import pytest

from rhizotwin.scenes.checks import check_scene
from rhizotwin.scenes.disturbances import Disturbances
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Camera, Canister, CapturePlan, Lights, MarkerStrip, NetPot, Ring, Scene, Water
from rhizotwin.scenes.specimens import GrownSpecimen, SphereSpecimen

MISFITS: list[tuple[str, dict[str, Any], str]] = [
    ("wall fills the canister", {"canister": Canister(outer_radius_mm=40.0, wall_mm=40.0)}, r"\[canister\] wall_mm = 40.*below"),
    ("water below the floor", {"water": Water(level_mm=-150.0)}, r"\[water\] level_mm = -150.0.*-146.4"),
    ("pot inside the canister", {"net_pot": NetPot(outer_radius_mm=76.2)}, r"\[net_pot\] outer_radius_mm.*above.*76.2"),
    ("grid below the floor", {"net_pot": NetPot(grid_z_mm=-147.0)}, r"\[net_pot\] grid_z_mm"),
    ("unknown dictionary", {"strip": MarkerStrip(dictionary="APRILTAG_36h12")}, r'APRILTAG_36h12.*"APRILTAG_36h11"'),
    ("dictionary too small", {"strip": MarkerStrip(dictionary="4X4_50")}, r"\[strip\] dictionary = \"4X4_50\".*50 markers.*62"),
    ("markers overlap", {"strip": MarkerStrip(marker_mm=16.2, row_pitch_mm=17.0)}, r"\[strip\] marker_mm = 16.2.*below 16.13 mm"),
    ("rows overlap", {"strip": MarkerStrip(row_pitch_mm=13.0)}, r"\[strip\] row_pitch_mm = 13.0.*above"),
    ("strip above the skirt", {"strip": MarkerStrip(bottom_mm=2.0)}, r"\[strip\] bottom_mm = 2.0.*between z = 2 and 31.5, .*to 31;"),
    ("no ring", {"plan": CapturePlan(rings=())}, r"\[plan\] rings.*at least one"),
    ("camera in the pot", {"plan": CapturePlan(rings=(Ring(), Ring(distance_mm=79.0)))}, r"\[plan.rings 2\] distance_mm = 79"),
    ("jitter into the pot", {"plan": CapturePlan(rings=(Ring(distance_mm=100.0, jitter_mm=5.0),))}, "jitter_mm"),
    ("backlight in the canister", {"lights": Lights(backlight_distance_mm=70.0)}, r"\[lights\] backlight_distance_mm"),
    ("front light in the canister", {"lights": Lights(front_xz_mm=(10.0, -20.0))}, r"\[lights\] front_xz_mm"),
    ("principal point far off", {"camera": Camera(principal_px=(399.5, 1201.0))}, r"principal_px element 2 = 1201"),
    ("folding lens", {"camera": Camera(distortion=(-3.0, 0.0, 0.0, 0.0, 0.0))}, r"\[camera\] distortion.*monotonic"),
    ("less than vacuum", {"water": Water(n_water=1.0), "disturbances": Disturbances(n_water_error=-0.01)}, "n_water_error = -0.01"),
    ("ball in the wall", {"specimen": SphereSpecimen(centre_mm=(50.0, 40.0, -55.0))}, r"\[specimen\] centre_mm.*within 73"),
    ("ball in the grid", {"specimen": SphereSpecimen(centre_mm=(0.0, 0.0, -17.0))}, r"-8 \(grid"),
    ("plant without roots", {"specimen": GrownSpecimen(orders=())}, r"\[specimen\] orders"),
]
"""Changes that make the default scene impossible, and what the message must name."""


@pytest.mark.parametrize(("change", "says"), [misfit[1:] for misfit in MISFITS], ids=[misfit[0] for misfit in MISFITS])
def test_misfit_is_refused(change: dict[str, Any], says: str) -> None:
    with pytest.raises(UserError, match=says) as caught:
        check_scene(replace(Scene(), **change), where="mine.toml")
    assert str(caught.value).startswith("mine.toml: [")


def test_what_fits_is_accepted() -> None:
    for scene in (
        Scene(),
        Scene(water=Water(n_water=1.0), canister=Canister(n_wall=1.0)),
        Scene(strip=MarkerStrip(first_id=525)),  # the last markers of the dictionary
        Scene(plan=CapturePlan(rings=(Ring(distance_mm=80.0),))),
    ):
        check_scene(scene)


def test_line_of_a_misfit() -> None:
    text = "[water]\nn_water = 1.333\nlevel_mm = -150.0\n"
    with pytest.raises(UserError, match=r"^mine\.toml, line 3: \[water\] level_mm"):
        check_scene(Scene(water=Water(level_mm=-150.0)), where="mine.toml", text=text)
