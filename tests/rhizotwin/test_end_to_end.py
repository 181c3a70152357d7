"""The commands one after the other, as a person types them."""

import json
import shutil
from pathlib import Path
from typing import Any

import nrrd
import numpy as np
import pytest
import trimesh

import rhizotwin as rt
from rhizotwin.corrections.session import Session
from rhizotwin.importer.colmap_model import read_colmap
from rhizotwin.importer.nerfstudio_file import read_cameras
from rhizotwin.scenes import files, frames
from rhizotwin.scenes.dataset import load_dataset
from rhizotwin.scenes.truth import load_truth
from rhizotwin.steps.example import write_example
from tests.command import Command
from tests.conftest import Reconstructed

pytestmark = pytest.mark.slow


def test_a_simulated_ball_is_found_and_scored(made: Path, found: Reconstructed, command: Command) -> None:
    score = json.loads(command.works("score", found.folder, made, "--json").out)
    assert score["volume_true_mm3"] == pytest.approx(4.0 / 3.0 * np.pi * 8.0**3, rel=0.02)  # less what the facets cut off
    assert score["volume_error"] == pytest.approx(0.0, abs=0.05)
    assert {"volume_mm3", "extents_error", "recall", "precision", "iou", "timings_s"} <= set(score)
    assert (found.folder / "pictures" / "shape.png").stat().st_size > 5000
    assert "volume" in command.works("score", found.folder, made).out


def test_exports_open_elsewhere_and_say_the_same(made: Path, found: Reconstructed, tmp_path: Path, command: Command) -> None:
    for name in ("root.stl", "root.glb", "root.ply", "root.nrrd", "cameras.json", "colmap"):
        words = ("export", found.folder, "-o", tmp_path / name, "--dataset", made)
        command.works(*words)
        command.fails(*words, named=["already exists"])
    volume = json.loads((found.folder / "result.json").read_text())["volume_mm3"]
    surface = trimesh.load_mesh(found.folder / "shape.ply")
    assert surface.volume == pytest.approx(volume, rel=0.02)  # and not inside out
    for name, unit in (("root.stl", 1.0), ("root.ply", 1.0), ("root.glb", 1000.0)):
        mesh = trimesh.load_mesh(tmp_path / name)
        assert mesh.volume * unit**3 == pytest.approx(surface.volume, rel=1e-3)
    up = trimesh.load_mesh(tmp_path / "root.glb").centroid * 1000.0
    np.testing.assert_allclose([up[0], -up[2], up[1]], surface.centroid, atol=0.01)

    block, header = nrrd.read(str(tmp_path / "root.nrrd"))
    step = header["space directions"][0][0]
    assert block.sum() / 255.0 * step**3 == pytest.approx(volume, rel=0.005)
    middle = np.array([np.average(np.arange(n), weights=block.sum(axis=tuple({0, 1, 2} - {axis}))) for axis, n in enumerate(block.shape)])
    np.testing.assert_allclose(header["space origin"] + step * middle, surface.centroid, atol=0.1)

    views = {view["file"]: np.array(view["cam_from_canister"]) for view in json.loads((found.folder / "result.json").read_text())["views"]}
    camera = load_dataset(made).scene.camera
    for read in (read_cameras(tmp_path / "cameras.json", camera), read_colmap(tmp_path / "colmap", camera)):
        assert read.camera == camera
        for file, pose in views.items():
            np.testing.assert_allclose(read.pictures[Path(file).name].cam_from_canister, pose, atol=1e-9)
    command.fails("export", found.folder, "-o", tmp_path / "other.json", named=["--dataset"])
    command.fails("export", found.folder, "-o", tmp_path / "root.xyz", named=[".stl"])


def test_the_truth_changes_nothing_in_the_result(made: Path, found: Reconstructed, tmp_path: Path) -> None:
    blind, out = tmp_path / "blind", tmp_path / "result"
    shutil.copytree(made, blind, ignore=shutil.ignore_patterns("truth"))
    rt.reconstruct(blind, voxel_mm=1.0).save(out)

    def content(folder: Path) -> tuple[Any, ...]:
        summary = json.loads((folder / "result.json").read_text())
        for key in ("dataset", "timings_s", "peak_memory_mib"):
            del summary[key]
        return summary, *((folder / name).read_bytes() for name in ("shape.npz", "shape.ply"))

    assert content(out) == content(found.folder)


def test_import_of_masks_with_cameras_gives_the_same_shape(made: Path, tmp_path: Path, command: Command) -> None:
    """The true silhouettes and cameras, in nerfstudio's form, lead to the true volume: axes, pixel centres and frames agree."""
    scene, truth = load_dataset(made).scene, load_truth(made)
    files.save_scene(scene, tmp_path / "rig.toml")
    poses = []
    for view in truth.views:
        world_from_gl = frames.invert(np.array(view.cam_from_canister)) @ np.diag([1.0, -1.0, -1.0, 1.0])
        poses.append({"file_path": view.file, "transform_matrix": world_from_gl.tolist()})
    (fx, fy), (cx, cy), (w, h) = scene.camera.focal_px, scene.camera.principal_px, scene.camera.image_wh
    lens = {"fl_x": fx, "fl_y": fy, "cx": cx + 0.5, "cy": cy + 0.5, "w": w, "h": h}
    (tmp_path / "transforms.json").write_text(json.dumps({**lens, "frames": poses}))
    out, given = tmp_path / "dataset", ("--cameras", tmp_path / "transforms.json", "--masks")
    command.works("import", made / "truth" / "masks", "--scene", tmp_path / "rig.toml", *given, "-o", out)
    result = rt.reconstruct(out, voxel_mm=0.6)
    shutil.copytree(made / "truth", out / "truth")
    score = rt.score(result, out).to_dict()
    assert score["volume_error"] == pytest.approx(0.0, abs=0.03)
    assert score["iou"] > 0.93


def test_the_example_has_the_present_format(tmp_path: Path, command: Command) -> None:
    write_example(tmp_path / "example")
    folder = tmp_path / "example" / "result"
    loaded, session = rt.load_result(folder), Session(folder)
    assert loaded.trusted
    assert (len(session.log.edits), len(session.state.lines)) == (1, len(loaded.roots) - 1)
    assert load_dataset(loaded.dataset).sha256 == loaded.dataset_sha256
    assert (folder / "report.html").read_text(encoding="utf-8").count("data:image/jpeg") == 2
    command.fails("demo", "--show", "--small", named=["--small"])
    command.fails("demo", "--show", "-o", folder.parent / "dataset", "--no-browser", named=["not empty"])
