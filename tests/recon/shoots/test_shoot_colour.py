"""Colour of a shoot from pictures with known light: an even leaf above a strip of paper, lit unevenly from view to view."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rhizotwin.recon.coverage.silhouettes import Silhouette
from rhizotwin.recon.optics.cameras import View
from rhizotwin.recon.read_pictures import Pictures
from rhizotwin.recon.shoots.shoot_colour import measure_colour
from rhizotwin.scenes import frames
from rhizotwin.scenes.atomic import write_image
from rhizotwin.scenes.bands import Band
from rhizotwin.scenes.dataset import Dataset, Frame
from rhizotwin.scenes.model import Camera, Scene

PAPER = 0.5
LEAF = {"red": 0.06, "red_edge": 0.3, "nir": 0.48}
NM = {"red": 670.0, "red_edge": 720.0, "nir": 850.0}


def colour_of(folder: Path, *, panel_level: float = 0.0, paper: float = PAPER):
    """Measure leaves in the upper half of two pictures, paper in the lower half; light differs by view and band."""
    bands = (Band(name="white"), *(Band(name=name, wavelength_nm=nm, panel_level=panel_level) for name, nm in NM.items()))
    scene = Scene(camera=replace(Camera().resized((200, 150)), bands=bands))
    listed = []
    for view, brightness in enumerate((1.0, 0.6)):
        for name, share in LEAF.items():
            light = np.full((150, 200), paper * brightness)
            light[:60] = paper * brightness * share
            write_image(folder / f"{view}_{name}.png", (light * 65535).astype(np.uint16))
            listed.append(Frame(file=f"{view}_{name}.png", sha256="", kind="shoot", band=name, view=view))
    lit = tuple(Frame(file=f"{view}_white.png", sha256="", kind="shoot", band="white", view=view) for view in (0, 1))
    dataset = Dataset(folder=folder, scene=scene, frames=(*lit, *listed))
    pictures = Pictures(dataset=dataset, frames=lit, images=(np.zeros((1, 1), np.uint8),) * 2)
    covered = np.zeros((150, 200), np.float32)
    covered[:60] = 1.0
    drawn = dict.fromkeys((0, 1), Silhouette(covered, np.ones((150, 200), bool)))
    still = frames.level_camera(distance_mm=400.0, height_mm=10.0, tilt_deg=0.0)
    return measure_colour(pictures, drawn, dict.fromkeys((0, 1), View(camera=scene.camera, cam_from_canister=still)))


def test_reflectances_are_relative_to_the_paper_in_the_same_light(tmp_path: Path) -> None:
    found = colour_of(tmp_path)
    assert found.reflectances == pytest.approx(LEAF, abs=2e-3)
    assert found.fields()["ndvi"] == pytest.approx((0.48 - 0.06) / (0.48 + 0.06), abs=2e-3)
    assert found.fields()["ndre"] == pytest.approx((0.48 - 0.3) / (0.48 + 0.3), abs=2e-3)
    assert found.warnings == ()


def test_light_through_the_leaves_counts_for_nothing(tmp_path: Path) -> None:
    """Half of the panel's near infrared comes through a leaf: with the panel on there is no index, and a reason."""
    found = colour_of(tmp_path, panel_level=0.75)
    assert found.fields() == {}
    assert "panel_level = 0" in found.warnings[0]


def test_paper_that_is_not_lit_gives_no_reflectance(tmp_path: Path) -> None:
    found = colour_of(tmp_path, paper=0.01)
    assert found.fields() == {}
    assert len(found.warnings) == len(LEAF)
