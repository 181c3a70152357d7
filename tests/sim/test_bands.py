"""The twin's bands: what changes with the wavelength, and the set of pictures with its truth."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rhizotwin.scenes.bands import Band
from rhizotwin.scenes.dataset import load_dataset, read_image
from rhizotwin.scenes.disturbances import Disturbances
from rhizotwin.scenes.model import Camera, CapturePlan, Ring, Scene
from rhizotwin.scenes.shoots import Shoot
from rhizotwin.scenes.specimens import SphereSpecimen
from rhizotwin.scenes.truth import load_truth
from rhizotwin.sim.bands import scene_in_band
from rhizotwin.sim.simulate import simulate

BANDS = (
    Band(name="white"),
    Band(name="red", wavelength_nm=675.0, panel_level=0.0, front_level=0.4),
    Band(name="nir", wavelength_nm=850.0, panel_level=0.5),
)
RINGS = (
    Ring(views=2, bands=("white", "nir")),
    Ring(views=1, height_mm=120.0, distance_mm=420.0, tilt_deg=10.0, kind="shoot"),
)
SCENE = Scene(
    camera=replace(Camera().resized((80, 60)), bands=BANDS),
    plan=CapturePlan(rings=RINGS),
    specimen=SphereSpecimen(diameter_mm=20.0),
    shoot=Shoot(),
    disturbances=Disturbances(root_mu_per_mm=0.4),
)


def test_a_band_has_its_own_light_leaves_roots_and_water() -> None:
    red, nir = scene_in_band(SCENE, "red"), scene_in_band(SCENE, "nir")
    assert scene_in_band(SCENE, "") is SCENE
    assert (red.lights.backlight_level, red.lights.front_level) == (0.0, 0.4)
    assert nir.lights.front_level == SCENE.lights.front_level
    assert (red.shoot.reflectance, nir.shoot.reflectance) == (0.05, pytest.approx(0.475))
    assert red.disturbances.root_mu_per_mm == pytest.approx(0.4 * 550.0 / 675.0), "scattering falls with the wavelength"
    assert nir.water.absorption_per_mm == pytest.approx(0.0043)
    assert nir.water.absorption_per_mm > 8.0 * red.water.absorption_per_mm


def test_a_set_has_a_picture_for_each_band_and_its_truth_the_indices(tmp_path: Path) -> None:
    simulate(SCENE, tmp_path / "d", profile_name="clean", seed=0, samples=4)
    dataset, truth = load_dataset(tmp_path / "d"), load_truth(tmp_path / "d")
    assert [(frame.view, frame.band) for frame in dataset.frames] == [
        *((view, band) for view in (0, 1) for band in ("white", "nir")),
        *((2, band) for band in ("white", "red", "nir")),
    ]
    assert [view.file for view in truth.views] == [frame.file for frame in dataset.frames]
    assert truth.views[2].cam_from_canister == truth.views[3].cam_from_canister, "one view, two bands"
    assert truth.shoot["ndvi"] == pytest.approx((0.475 - 0.05) / (0.475 + 0.05))
    white, nir = (read_image(dataset, frame) / 65535.0 for frame in dataset.frames[:2])
    panel = white > 0.74
    # Through 146 mm of water at most, by Beer and Lambert; beside the canister there is none.
    assert nir[panel].max() == pytest.approx(0.5, abs=0.01)
    assert np.exp(-0.0043 * 146.1) * 0.9 < nir[20:40, 30:50].max() / 0.5 < 1.0
