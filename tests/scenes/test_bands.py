"""Bands of a camera: which stand for which range, and how pictures of one view belong together."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from rhizotwin.scenes import plan
from rhizotwin.scenes.bands import Band, bands_by_range, vegetation_indices
from rhizotwin.scenes.dataset import Dataset, Frame, load_dataset, save_dataset
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.files import load_scene
from rhizotwin.scenes.model import Camera, CapturePlan, Ring, Scene

WHITE, RED, NIR = Band(name="white"), Band(name="red", wavelength_nm=670.0, panel_level=0.0), Band(name="nir", wavelength_nm=850.0)
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


FRAMES: dict[str, tuple[tuple[Frame, ...], Scene, str]] = {
    "no band": ((frame("a", view=0),), SCENE, r"\[frames 1\] band.*one of the camera's bands, white, red, nir"),
    "no view": ((frame("a", band="red"),), SCENE, r"\[frames 1\] view.*is missing"),
    "same band": (
        (frame("a", band="red", view=0), frame("b", band="red", view=0)),
        SCENE,
        r"\[frames 2\] view.*differ from the view of images/a",
    ),
    "camera without bands": ((frame("a", band="red", view=0),), Scene(), r"\[frames 1\] band.*has no bands"),
}


@pytest.mark.parametrize(("frames", "scene", "says"), FRAMES.values(), ids=FRAMES)
def test_frames_that_contradict_the_bands_are_refused(frames: tuple[Frame, ...], scene: Scene, says: str, tmp_path: Path) -> None:
    save_dataset(Dataset(folder=tmp_path, scene=scene, frames=frames))
    with pytest.raises(UserError, match=says):
        load_dataset(tmp_path)


def test_frames_of_a_scene_with_bands_come_back(tmp_path: Path) -> None:
    scene = replace(load_scene("radish_bands"), specimen=None, shoot=None)
    made = save_dataset(Dataset(folder=tmp_path, scene=scene, frames=(frame("a", band="white", view=0), frame("b", band="nir", view=0))))
    assert load_dataset(tmp_path) == made
