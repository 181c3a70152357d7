"""What is drawn, and a dataset as a whole: repeatable, resumable, in bands, and silent about its truth."""

import re
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh

import rhizotwin.sim.render
import rhizotwin.sim.simulate
from rhizotwin.scenes import frames, plan
from rhizotwin.scenes.bands import Band
from rhizotwin.scenes.dataset import Dataset, load_dataset, read_image
from rhizotwin.scenes.disturbances import Disturbances
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.files import load_profile
from rhizotwin.scenes.model import Camera, Canister, CapturePlan, NetPot, Ring, Scene
from rhizotwin.scenes.shoots import Shoot
from rhizotwin.scenes.specimens import MeshSpecimen, SphereSpecimen
from rhizotwin.scenes.truth import load_truth
from rhizotwin.sim.bands import scene_in_band
from rhizotwin.sim.render import Renderer
from rhizotwin.sim.simulate import CannotContinueError, simulate
from rhizotwin.sim.world import World, draw_world

pytestmark = pytest.mark.usefixtures("coarse_ball")
WRONG = Disturbances(full_well_e=8000.0, read_noise_e=3.0, aperture_mm=1.5, arm_deg=0.3, table_deg=0.05, canister_offset_mm=1.0)


def tiny(*, views: int = 3, wrong: Disturbances = WRONG) -> Scene:
    scene = Scene(name="tiny", specimen=SphereSpecimen(diameter_mm=30.0), disturbances=wrong, plan=CapturePlan(rings=(Ring(views=views),)))
    return replace(scene, camera=scene.camera.resized((64, 48)))


def make(folder: Path, scene: Scene, *, seed: int = 7) -> Dataset:
    return simulate(scene, folder, profile_name="test", seed=seed, samples=4)


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("whole") / "set"
    make(folder, tiny())
    return folder


@pytest.fixture
def copy(whole: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(whole, tmp_path / "set"))


def test_a_set_holds_pictures_and_truth(whole: Path) -> None:
    scene, read, truth = tiny(), load_dataset(whole), load_truth(whole)
    assert read.scene.disturbances == Disturbances()
    assert read_image(read, read.frames[1]).shape == (48, 64)
    assert (read.origin["fidelity"], read.origin["profile"], read.seed) == ("backlit", "test", 7)
    np.testing.assert_allclose(truth.views[2].cam_from_canister, draw_world(scene, seed=7).cameras[2].cam_from_canister)
    assert truth.volume_mm3 == pytest.approx(np.pi / 6.0 * 30.0**3, rel=1e-3)
    mask = cv2.imread(str(whole / "truth" / "masks" / "view_001.png"), cv2.IMREAD_UNCHANGED)
    assert mask.dtype == np.uint16
    assert mask.max() == 65535


def test_the_manifest_tells_nothing_of_the_specimen(tmp_path: Path) -> None:
    ball = trimesh.creation.icosphere(subdivisions=2, radius=9.0)
    ball.apply_translation((0.0, 0.0, -14.5))
    ball.invert()
    ball.export(tmp_path / "secret_ball.stl")
    scene = replace(tiny(views=1), description="a ball of 3 ml", specimen=MeshSpecimen(file=str(tmp_path / "secret_ball.stl")))
    made = make(tmp_path / "set", scene)
    truth = load_truth(tmp_path / "set")
    notes = truth.drawn["notes"]
    assert len(notes) == 2
    assert "pointed inwards" in notes[0]
    assert truth.drawn["specimen"]["file"] == scene.specimen.file
    # A checksum may hold any four digits in a row by chance.
    text = re.sub(r'"[0-9a-f]{40,64}"', '""', (tmp_path / "set" / "dataset.json").read_text())
    for secret in (repr(truth.volume_mm3), f"{truth.volume_mm3:.0f}", "secret_ball", "mesh", "3 ml", "table_from_canister", *notes):
        assert secret not in text
    assert made.scene.specimen is None
    assert not made.scene.description


def test_an_interrupted_set_resumes_to_the_same_bytes(whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rendered: list[int] = []
    view = Renderer.view

    def stopped(self: Renderer, k: int) -> object:
        rendered.append(k)
        if rendered == [0, 1, 2]:
            raise KeyboardInterrupt
        return view(self, k)

    monkeypatch.setattr(Renderer, "view", stopped)
    with pytest.raises(KeyboardInterrupt):
        make(tmp_path, tiny())
    assert not (tmp_path / "dataset.json").exists()
    make(tmp_path, tiny())
    assert rendered == [0, 1, 2, 2]
    assert contents(tmp_path) == contents(whole)


def test_a_damaged_frame_is_rendered_anew(whole: Path, copy: Path) -> None:
    (copy / "images" / "view_001.png").write_bytes(b"cut off")
    make(copy, tiny())
    assert contents(copy) == contents(whole)


def test_another_setting_or_a_foreign_folder_is_refused(copy: Path, tmp_path: Path) -> None:
    with pytest.raises(UserError, match="seed"):
        make(copy, tiny(), seed=1)
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "thesis.txt").write_text("important")
    with pytest.raises(UserError, match="contains files that are not"):
        make(tmp_path / "other", tiny())
    (copy / rhizotwin.sim.simulate.PROGRESS_FILE).write_text("{")
    with pytest.raises(UserError, match="damaged"):
        make(copy, tiny())


def test_a_set_begun_with_another_program_is_refused(whole: Path, copy: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rhizotwin.sim.simulate, "versions", lambda names: {"rhizotwin": "8.8"} | dict.fromkeys(names, "9.9"))
    with pytest.raises(CannotContinueError, match=r"with different settings \(rhizotwin \(.*, now 8\.8\), mitsuba \(3.*, now 9\.9\)"):
        make(copy, tiny())
    assert contents(copy) == contents(whole)


RED = Band(name="red", wavelength_nm=675.0, panel_level=0.0, front_level=0.4)
BANDS = (Band(name="white"), RED, Band(name="nir", wavelength_nm=850.0, panel_level=0.5))
RINGS = (Ring(views=2, bands=("white", "nir")), Ring(views=1, height_mm=120.0, distance_mm=420.0, tilt_deg=10.0, kind="shoot"))
SCENE = Scene(
    camera=replace(Camera().resized((80, 60)), bands=BANDS), plan=CapturePlan(rings=RINGS),
    specimen=SphereSpecimen(diameter_mm=20.0), shoot=Shoot(), disturbances=Disturbances(root_mu_per_mm=0.4),
)  # fmt: skip


def test_a_band_has_its_own_light_leaves_roots_and_water() -> None:
    red, nir = scene_in_band(SCENE, "red"), scene_in_band(SCENE, "nir")
    assert (red.lights.backlight_level, red.lights.front_level) == (0.0, 0.4)
    assert (red.shoot.reflectance, nir.shoot.reflectance) == (0.05, pytest.approx(0.475))
    assert red.disturbances.root_mu_per_mm == pytest.approx(0.4 * 550.0 / 675.0), "scattering falls with the wavelength"
    assert nir.water.absorption_per_mm == pytest.approx(0.0043)


def test_a_set_has_a_picture_a_band_and_its_truth_the_indices(tmp_path: Path) -> None:
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


DIRTY = replace(load_profile("harsh"), algae_patches=20, algae_opacity=0.5, felt_fibres=30, bubbles=30, backlight_unevenness=0.3)


def world_of(seed: int, *, rings: tuple[Ring, ...] = (Ring(views=6), Ring(views=4, height_mm=90.0)), wrong: Disturbances = DIRTY) -> World:
    return draw_world(Scene(plan=CapturePlan(rings=rings), disturbances=wrong), seed=seed)


def test_a_perfect_rig_is_where_the_plan_says() -> None:
    scene = Scene(plan=CapturePlan(rings=(Ring(views=7, jitter_mm=2.0, jitter_deg=1.0),)))
    world = draw_world(scene, seed=3)
    for view, camera in zip(plan.views(scene, seed=3), world.cameras, strict=True):
        np.testing.assert_allclose(camera.cam_from_canister, view.cam_from_rig @ plan.rig_from_table(scene, view.table_deg), atol=1e-12)
    assert world.n_water == scene.water.n_water
    np.testing.assert_array_equal(world.canister_from_strip, np.eye(4))
    assert world.backlight is None
    assert not world.algae + world.fibres + world.bubbles


def test_the_arm_errs_once_a_ring_and_the_table_in_every_view() -> None:
    world = world_of(2)
    first, second = world.cameras[:6], world.cameras[6:]
    for camera in first:
        np.testing.assert_array_equal(camera.cam_from_rig, first[0].cam_from_rig)
    nominal = (frames.level_camera(distance_mm=400.0, height_mm=z, tilt_deg=0.0) for z in (-42.0, 90.0))
    errors = [camera.cam_from_rig @ frames.invert(n) for camera, n in zip((first[0], second[0]), nominal, strict=True)]
    assert np.abs(errors[0] - errors[1]).max() > 1e-3
    offsets = [camera.table_deg - 60.0 * k for k, camera in enumerate(first)]
    assert len(set(offsets)) == 6


def test_errors_have_the_size_that_the_profile_names() -> None:
    nominal = frames.invert(frames.level_camera(distance_mm=400.0, height_mm=-42.0, tilt_deg=0.0))
    clear = replace(DIRTY, algae_patches=0, felt_fibres=0, bubbles=0)
    worlds = [world_of(seed, rings=(Ring(views=1),), wrong=clear) for seed in range(150)]
    arms = np.array([frames.to_rotvec(world.cameras[0].cam_from_rig @ nominal) for world in worlds])
    assert np.rad2deg(arms).std() == pytest.approx(0.3, rel=0.12)
    seat = world_of(9).table_from_canister
    assert np.linalg.norm(seat[:3, 3]) == pytest.approx(1.0)
    assert np.rad2deg(np.linalg.norm(frames.to_rotvec(seat))) == pytest.approx(0.5)
    assert np.ptp(world_of(9).backlight) == pytest.approx(0.3)


def test_dirt_stays_in_the_water() -> None:
    world, can = world_of(4), Canister()
    x, y, z, radius = np.array([(bubble.x_mm, bubble.y_mm, bubble.z_mm, bubble.radius_mm) for bubble in world.bubbles]).T
    assert (np.hypot(x, y) + radius).max() < can.inner_radius_mm
    assert can.floor_z_mm < (z - radius).min() < (z + radius).max() < NetPot().grid_z_mm
    assert np.hypot(*np.concatenate([fibre.points_mm for fibre in world.fibres])[:, :2].T).max() < can.inner_radius_mm
    assert {fibre.points_mm[:, 2].max() for fibre in world.fibres} == {NetPot().grid_z_mm}
