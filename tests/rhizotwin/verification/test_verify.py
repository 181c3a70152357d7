"""A right result agrees with its rendering, a wrong one is named; rays of the twin are those of the export."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import rhizotwin as rt
from rhizotwin.exporter import rays
from rhizotwin.recon.calibration.cameras import HELD_OUT
from rhizotwin.recon.optics.cameras import View
from rhizotwin.recon.optics.refraction import Optics
from rhizotwin.recon.results.result import Result
from rhizotwin.scenes import frames
from rhizotwin.scenes.dataset import load_dataset
from rhizotwin.scenes.model import Camera, Scene
from rhizotwin.verification.synthesis import Synthesis, true_camera
from tests.command import Command
from tests.conftest import Reconstructed
from tests.recon.hull.exact_pictures import cameras_of


def moved(result: Result, shift_mm: tuple[float, float, float]) -> Result:
    """Return a result whose shape is displaced."""
    mesh = result.solid.mesh.copy()
    mesh.apply_translation(shift_mm)
    return replace(result, solid=replace(result.solid, mesh=mesh))


def test_a_right_result_agrees_and_its_residuals_are_written(made: Path, found: Reconstructed, tmp_path: Path, command: Command) -> None:
    done = command.works("verify", found.folder, made, "-o", tmp_path / "check", "--device", "cpu")
    assert "agrees with 8 used pictures" in done.out
    assert "repeat the reconstruction with --hold-out" in done.out
    kept = json.loads((tmp_path / "check" / "verify.json").read_text())
    assert (kept["agrees"], kept["problems"], kept["held_out"]) == (True, [], False)
    assert min(kept["explained"].values()) > 0.99
    assert abs(kept["canister"]["error"]) < 1e-3
    assert len(list((tmp_path / "check" / "residuals").glob("*.png"))) == 8


def test_a_displaced_shape_is_named(made: Path, found: Reconstructed) -> None:
    wrong = rt.verify(moved(found.result, (0.0, 0.0, -10.0)), made)
    assert not wrong.agrees
    assert "are missing in the result" in wrong.verdict
    assert "are not in the pictures" in wrong.verdict
    assert np.hypot(*np.mean(list(wrong.displaced_px.values()), axis=0)) > 1.0


def test_another_size_of_the_canister_is_named(made: Path, found: Reconstructed, tmp_path: Path, command: Command) -> None:
    shutil.copytree(made, tmp_path / "scan")
    listed = json.loads((tmp_path / "scan" / "dataset.json").read_text())
    listed["scene"]["canister"]["outer_radius_mm"] *= 1.02
    (tmp_path / "scan" / "dataset.json").write_text(json.dumps(listed))
    command.fails("verify", found.folder, tmp_path / "scan", named=["not reconstructed from the present content"])
    scan = load_dataset(tmp_path / "scan")
    wrong = rt.verify(replace(found.result, dataset_sha256=scan.sha256), scan)
    assert wrong.canister is not None
    assert wrong.canister.error == pytest.approx(1.0 / 1.02 - 1.0, abs=2e-3)
    assert "the radius of the canister is wrong" in wrong.verdict


def test_masks_are_refused(made: Path, found: Reconstructed) -> None:
    with pytest.raises(rt.UserError, match="contains masks without light"):
        rt.verify(found.result, replace(load_dataset(made), masks=True))


def test_every_nth_view_is_held_out() -> None:
    view = View(camera=Camera(), cam_from_canister=frames.translation(0.0, 0.0, 400.0))
    cameras = cameras_of([view] * 11, Optics.from_scene(Scene()))
    kept = cameras.hold_out(5)
    assert kept.order == (0, 1, 2, 3, 5, 6, 7, 8, 10)
    assert [(k, camera.used, camera.reason) for k, camera in kept.held_out.items()] == [(4, False, HELD_OUT), (9, False, HELD_OUT)]
    assert cameras.hold_out(0) is cameras
    with pytest.raises(rt.UserError, match="leaves 0 of 11 pictures"):
        cameras.hold_out(1)


def test_rays_of_the_twin_are_those_of_the_export(made: Path, found: Reconstructed) -> None:
    scene, camera = load_dataset(made).scene, found.result.cameras[3]
    assert camera.cam_from_canister is not None
    view = View(camera=scene.camera.as_pinhole(), cam_from_canister=camera.cam_from_canister)
    exported = rays.trace(view, Optics.from_scene(scene), scene)
    synthesis = Synthesis(found.result, scene)
    px = np.argwhere(synthesis.opacity(true_camera(camera, scene)) > 0.0)[:, ::-1]
    px = px[np.isfinite(exported.length_mm[px[:, 1], px[:, 0]])]
    traced = synthesis.rays(true_camera(camera, scene), px.astype(np.float64))
    assert traced.known.sum() > 400
    start, along, length = (
        part[px[:, 1], px[:, 0]].astype(np.float64) for part in (exported.origin_mm, exported.direction, exported.length_mm)
    )
    for share in (0.3, 0.7):
        apart = traced.offset_mm(start + share * length[:, None] * along)[traced.known]
        assert np.abs(apart).max() < 2e-3  # mm, a two-hundredth of a pixel
