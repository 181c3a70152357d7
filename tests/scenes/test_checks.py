"""Parts of a scene that do not fit each other are refused; bands of a camera, and how pictures of one view belong together."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from rhizotwin.scenes import plan
from rhizotwin.scenes.bands import Band, bands_by_range, vegetation_indices
from rhizotwin.scenes.checks import check_scene
from rhizotwin.scenes.dataset import Dataset, Frame, load_dataset, save_dataset
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Camera, Canister, CapturePlan, Lights, MarkerStrip, NetPot, Ring, Scene, Tank, Water
from rhizotwin.scenes.plants import Plant
from rhizotwin.scenes.specimens import GrownSpecimen, SphereSpecimen

WHITE, RED, NIR = Band(name="white"), Band(name="red", wavelength_nm=670.0, panel_level=0.0), Band(name="nir", wavelength_nm=850.0)
BANDS, TABLE = Camera(bands=(WHITE, RED, NIR)), (0.0, 0.7, 0.5)
A, WIDE = Plant(plant="A"), Plant(plant="A", at_mm=(60.0, 0.0), specimen=SphereSpecimen(diameter_mm=40.0))
LOW = CapturePlan(rings=(Ring(height_mm=-100.0),))


def bands_of(*names: str) -> dict[str, Any]:
    return {"camera": BANDS, "plan": CapturePlan(rings=(Ring(bands=names),))}


MISFITS: list[tuple[str, dict[str, Any], str]] = [
    ("wall fills the canister", {"canister": Canister(outer_radius_mm=40.0, wall_mm=40.0)}, r"\[canister\] wall_mm = 40.*below"),
    ("canister in centimetres", {"canister": Canister(outer_radius_mm=7.62)}, r"outer_radius_mm = 7.62: .*7.62 centimetres are 76.2 mm"),
    ("pot in inches", {"net_pot": NetPot(outer_radius_mm=3.134)}, r"\[net_pot\] outer_radius_mm = 3.134.*inches are 79.6"),
    ("camera in metres", {"plan": CapturePlan(rings=(Ring(distance_mm=0.4),))}, r"0.4 metres are 400 mm"),
    ("half a canister", {"canister": Canister(outer_radius_mm=38.1)}, r"outer_radius_mm = 38.1: must be at least 39.8"),
    ("water below the floor", {"water": Water(level_mm=-150.0)}, r"\[water\] level_mm = -150.0.*-146.4"),
    ("pot inside the canister", {"net_pot": NetPot(outer_radius_mm=76.2)}, r"\[net_pot\] outer_radius_mm.*above.*76.2"),
    ("dictionary too small", {"strip": MarkerStrip(dictionary="4X4_50")}, r"\[strip\] dictionary = \"4X4_50\".*50 markers.*62"),
    ("markers overlap", {"strip": MarkerStrip(marker_mm=16.2, row_pitch_mm=17.0)}, r"\[strip\] marker_mm = 16.2.*below 16.13 mm"),
    ("strip above the skirt", {"strip": MarkerStrip(bottom_mm=2.0)}, r"\[strip\] bottom_mm = 2.0.*between z = 2 and 31.5, .*to 31;"),
    ("no ring", {"plan": CapturePlan(rings=())}, r"\[plan\] rings.*at least one"),
    ("camera in the pot", {"plan": CapturePlan(rings=(Ring(), Ring(distance_mm=79.0)))}, r"\[plan.rings 2\] distance_mm = 79"),
    ("backlight in the canister", {"lights": Lights(backlight_distance_mm=70.0)}, r"\[lights\] backlight_distance_mm"),
    ("principal point far off", {"camera": Camera(principal_px=(399.5, 1201.0))}, r"principal_px element 2 = 1201"),
    ("folding lens", {"camera": Camera(distortion=(-3.0, 0.0, 0.0, 0.0, 0.0))}, r"\[camera\] distortion.*monotonic"),
    ("ball in the wall", {"specimen": SphereSpecimen(centre_mm=(50.0, 40.0, -55.0))}, r"\[specimen\] centre_mm.*within 73"),
    ("plant without roots", {"specimen": GrownSpecimen(orders=())}, r"\[specimen\] orders"),
    ("band of two words", {"camera": Camera(bands=(Band(name="near infrared"),))}, r"\[camera.bands 1\] name.*one lower-case word"),
    ("unknown band in a ring", bands_of("blue"), r"\[plan.rings 1\].*which are white, red, nir"),
    ("dark ring", bands_of("red"), "panel and front light are on"),
    ("table that falls", {"camera": Camera(transfer="table", transfer_table=TABLE)}, "transfer"),
    ("tank too near", {"tank": Tank(front_mm=70.0)}, "so that the canister can rotate"),
    ("tank beyond the backlight", {"tank": Tank(front_mm=300.0)}, "below lights.backlight_distance_mm"),
    ("strip through the tank", {"tank": Tank(), "plan": LOW}, "strip's lower edge is behind the tank's liquid"),
    ("plant twice", {"plants": (A, replace(A, at_mm=(9.0, 0.0)))}, "is already the name of another plant"),
    ("plant in the wall", {"plants": (replace(A, at_mm=(80.0, 0.0)),)}, "inside the canister's wall"),
    ("plants in one place", {"plants": (A, Plant(plant="B", at_mm=(1.0, 0.0)))}, "must be at least 2 mm from A"),
    ("specimen of a plant", {"plants": (WIDE,)}, "must be within the water"),
]
"""Changes that make the default scene impossible, and what the message must name."""


@pytest.mark.parametrize(("change", "says"), [misfit[1:] for misfit in MISFITS], ids=[misfit[0] for misfit in MISFITS])
def test_misfit_is_refused(change: dict[str, Any], says: str) -> None:
    with pytest.raises(UserError, match=says) as caught:
        check_scene(replace(Scene(), **change), where="mine.toml")
    assert str(caught.value).startswith(("mine.toml: [", "mine.toml: specimen: "))


FITTING: dict[str, dict[str, Any]] = {
    "last markers of the dictionary": {"strip": MarkerStrip(first_id=525)},
    "camera close to the pot": {"plan": CapturePlan(rings=(Ring(distance_mm=80.0),))},
    "tank without a strip before it": {"tank": Tank(), "plan": LOW, "strip": MarkerStrip(rows=0)},
}


@pytest.mark.parametrize("change", FITTING.values(), ids=FITTING)
def test_what_fits_is_accepted(change: dict[str, Any]) -> None:
    check_scene(replace(Scene(), **change))


def test_line_of_a_misfit() -> None:
    text = "[water]\nn_water = 1.333\nlevel_mm = -150.0\n"
    with pytest.raises(UserError, match=r"^mine\.toml, line 3: \[water\] level_mm"):
        check_scene(Scene(water=Water(level_mm=-150.0)), where="mine.toml", text=text)


SCENE = Scene(camera=Camera(bands=(WHITE, RED, NIR)), plan=CapturePlan(rings=(Ring(views=2), Ring(views=2, bands=("red", "white")))))


def test_views_are_taken_in_the_bands_of_their_ring() -> None:
    assert plan.ring_bands(SCENE, 0) == ("white", "red", "nir")
    assert plan.ring_bands(SCENE, 1) == ("red", "white")
    assert plan.main_band(SCENE, 1) == "white", "red has no panel"
    assert plan.ring_bands(Scene(), 0) == ("",)
    assert (plan.picture_name(7, "red"), plan.picture_name(7, "")) == ("view_007_red", "view_007")


def test_ranges_have_their_nearest_band_and_indices_a_formula() -> None:
    near = Band(name="near", wavelength_nm=800.0)
    assert bands_by_range((WHITE, RED, NIR, near)) == {"green": "white", "red": "red", "nir": "nir"}
    assert vegetation_indices({"red": 0.05, "nir": 0.45}) == {"ndvi": pytest.approx(0.8)}
    assert vegetation_indices({"red": 0.05, "nir": 0.45, "red_edge": 0.25})["ndre"] == pytest.approx(0.2 / 0.7)
    assert vegetation_indices({"red": 0.05}) == {}


def frame(name: str, **changes: Any) -> Frame:
    return Frame(file=f"images/{name}.png", sha256="", **changes)


FRAMES = {
    "no band": ((frame("a", view=0),), r"\[frames 1\] band.*one of the camera's bands, white, red, nir"),
    "same band": (tuple(frame(name, band="red", view=0) for name in "ab"), r"\[frames 2\] view.*differ from the view of images/a"),
}


@pytest.mark.parametrize(("frames", "says"), FRAMES.values(), ids=FRAMES)
def test_frames_that_contradict_the_bands_are_refused(frames: tuple[Frame, ...], says: str, tmp_path: Path) -> None:
    save_dataset(Dataset(folder=tmp_path, scene=SCENE, frames=frames))
    with pytest.raises(UserError, match=says):
        load_dataset(tmp_path)
