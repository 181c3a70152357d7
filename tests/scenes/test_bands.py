"""Bands of a camera: which stand for which range, and how pictures of one view belong together."""

from pathlib import Path
from typing import Any

import pytest

from rhizotwin.scenes import plan
from rhizotwin.scenes.bands import Band, bands_by_range, vegetation_indices
from rhizotwin.scenes.dataset import Dataset, Frame, load_dataset, save_dataset
from rhizotwin.scenes.errors import UserError
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


FRAMES = {
    "no band": ((frame("a", view=0),), r"\[frames 1\] band.*one of the camera's bands, white, red, nir"),
    "same band": (tuple(frame(name, band="red", view=0) for name in "ab"), r"\[frames 2\] view.*differ from the view of images/a"),
}


@pytest.mark.parametrize(("frames", "says"), FRAMES.values(), ids=FRAMES)
def test_frames_that_contradict_the_bands_are_refused(frames: tuple[Frame, ...], says: str, tmp_path: Path) -> None:
    save_dataset(Dataset(folder=tmp_path, scene=SCENE, frames=frames))
    with pytest.raises(UserError, match=says):
        load_dataset(tmp_path)
