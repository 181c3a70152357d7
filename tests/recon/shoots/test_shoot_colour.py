"""Colour of a shoot from pictures with known light: an even leaf above a strip of paper, lit unevenly from view to view."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rhizotwin.recon.coverage.silhouettes import Silhouette
from rhizotwin.recon.optics.cameras import View
from rhizotwin.recon.read_pictures import CurveFound, Pictures
from rhizotwin.recon.shoots.blades import Blades
from rhizotwin.recon.shoots.shoot_colour import measure_colour
from rhizotwin.scenes import frames
from rhizotwin.scenes.atomic import write_image
from rhizotwin.scenes.bands import Band
from rhizotwin.scenes.dataset import Dataset, Frame
from rhizotwin.scenes.model import Camera, Scene
from rhizotwin.scenes.transfer import LINEAR, SRGB, Curve

PAPER = 0.5
LEAF = {"red": 0.06, "red_edge": 0.3, "nir": 0.48}
NM = {"red": 670.0, "red_edge": 720.0, "nir": 850.0}


def two_leaves(view: View) -> Blades:
    """Return points all over the upper part of a picture: a stalk on its left, then two leaves."""
    x, y = (part.ravel() for part in np.meshgrid(np.arange(0.0, 200.0, 0.5), np.arange(0.0, 70.0, 0.5)))
    (fx, fy), (u, v) = view.camera.focal_px, view.camera.principal_px
    cam = 390.0 * np.stack([(x - u) / fx, (y - v) / fy, np.ones_like(x)], axis=1)
    leaf = np.digitize(x, [40.0, 120.0]) - 1
    points = frames.apply(frames.invert(view.cam_from_canister), cam)
    return Blades(points_mm=points, is_blade=leaf >= 0, leaf=leaf, areas_mm2=(80.0, 70.0), area_mm2=150.0)


def colour_of(
    folder: Path,
    *,
    panel_level: float = 0.0,
    paper: float = PAPER,
    damaged: str = "",
    curve: Curve = LINEAR,
    bright: int = 0,
    pale: float = 1.0,
):
    """Measure leaves in the upper half of two pictures, paper in the lower half; light differs by view and band.

    The second view's leaves are shaded, in all bands alike; a damaged picture cannot be read. In near infrared,
    ``bright`` of the 200 columns of leaves are three times as bright as the full scale, and those of the second leaf are
    multiplied by ``pale``.
    """
    bands = (Band(name="white"), *(Band(name=name, wavelength_nm=nm, panel_level=panel_level) for name, nm in NM.items()))
    scene = Scene(camera=replace(Camera().resized((200, 150)), bands=bands))
    listed = []
    for view, (brightness, shade) in enumerate(((1.0, 1.0), (0.6, 0.5))):
        for name, share in LEAF.items():
            light = np.full((150, 200), paper * brightness)
            light[:60] *= share * shade
            light[:60, : bright if name == "nir" else 0] = 3.0
            light[:60, 120:] *= pale if name == "nir" else 1.0
            write_image(folder / f"{view}_{name}.png", np.rint(curve.number(light.clip(0.0, 1.0)) * 65535).astype(np.uint16))
            listed.append(Frame(file=f"{view}_{name}.png", sha256="", kind="shoot", band=name, view=view))
    if damaged:
        (folder / damaged).write_bytes(b"no picture")
    lit = tuple(Frame(file=f"{view}_white.png", sha256="", kind="shoot", band="white", view=view) for view in (0, 1))
    dataset = Dataset(folder=folder, scene=scene, frames=(*lit, *listed))
    known = CurveFound(curve=curve, stated=LINEAR, bend=0.0, stated_bend=0.18, markers=100)
    pictures = Pictures(dataset=dataset, frames=lit, images=(np.zeros((1, 1), np.uint8),) * 2, curve=known)
    covered = np.zeros((150, 200), np.float32)
    covered[:60] = 1.0
    drawn = dict.fromkeys((0, 1), Silhouette(covered, np.ones((150, 200), bool)))
    still = frames.level_camera(distance_mm=400.0, height_mm=10.0, tilt_deg=0.0)
    view = View(camera=scene.camera, cam_from_canister=still)
    return measure_colour(pictures, drawn, dict.fromkeys((0, 1), view), two_leaves(view))


INDICES = {"ndvi": (0.48 - 0.06) / (0.48 + 0.06), "ndre": (0.48 - 0.3) / (0.48 + 0.3)}


@pytest.mark.parametrize("curve", [LINEAR, SRGB], ids=["linear", "undeclared curve"])
def test_reflectances_are_relative_to_paper_in_the_same_light(curve: Curve, tmp_path: Path) -> None:
    found = colour_of(tmp_path, curve=curve)
    assert found.values == pytest.approx({f"reflectance_{name}": 0.75 * share for name, share in LEAF.items()} | INDICES, abs=2e-3)
    assert found.warnings == ()


def test_each_leaf_has_its_own_index(tmp_path: Path) -> None:
    found = colour_of(tmp_path, pale=0.5)
    pale = {"ndvi": (0.24 - 0.06) / (0.24 + 0.06), "ndre": (0.24 - 0.3) / (0.24 + 0.3)}
    # at the border of both leaves, points of the nearest one hide two pixels of the other
    assert [{name: one[name] for name in INDICES} for one in found.leaves] == [
        pytest.approx(INDICES, abs=0.02),
        pytest.approx(pale, abs=0.02),
    ]
    assert pale["ndvi"] < found.values["ndvi"] < INDICES["ndvi"]


def test_a_damaged_picture_costs_its_view_and_not_the_index(tmp_path: Path) -> None:
    """The other bands of that view have shaded leaves, which must not count against the remaining picture."""
    found = colour_of(tmp_path, damaged="1_nir.png")
    assert {name: found.values[name] for name in INDICES} == pytest.approx(INDICES, abs=2e-3)
    assert found.values["reflectance_nir"] == pytest.approx(0.48, abs=2e-3)
    assert "1_nir.png is not used for the colour of the shoot" in found.warnings[0]


def test_light_through_leaves_and_unlit_paper_tell_nothing(tmp_path: Path) -> None:
    """Half of the panel's near infrared comes through a leaf: with the panel on there is no index, and a reason."""
    through, unlit = colour_of(tmp_path, panel_level=0.75), colour_of(tmp_path, paper=0.01)
    assert through.values == unlit.values == {}
    assert "panel_level = 0" in through.warnings[0]
    assert len(unlit.warnings) == len(LEAF)


def test_saturated_leaves_give_no_reflectance_and_a_remedy(tmp_path: Path) -> None:
    """Their true brightness is unknown: clipped near infrared would make the index too small. A highlight alone is no saturation."""
    found = colour_of(tmp_path, bright=20)
    assert set(found.values) == {"reflectance_red", "reflectance_red_edge"}
    assert "2 of 2 pictures in the band nir" in found.warnings[0]
    assert "reduce front_level" in found.warnings[0]
    assert "ndvi" in colour_of(tmp_path, bright=1).values
