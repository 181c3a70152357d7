"""The commands one after the other, as a person types them, and what they say to bad input."""

import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import nrrd
import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from rhizotwin import cli
from rhizotwin.nerfstudio import read_cameras
from rhizotwin.scenes import files, frames
from rhizotwin.scenes.dataset import load_dataset
from rhizotwin.scenes.truth import load_truth

SIZE = ["--views", "11", "--image-wh", "280x210"]


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Simulate a ball from an STL file beside the axis."""
    folder = tmp_path_factory.mktemp("end_to_end")
    ball = trimesh.creation.icosphere(subdivisions=4, radius=10.0)
    ball.apply_translation((12.0, -5.0, -60.0))
    ball.export(folder / "ball.stl")
    out = folder / "dataset"
    assert cli.main(["simulate", "sphere_20mm", "--specimen", str(folder / "ball.stl"), "-o", str(out), "--device", "cpu", *SIZE]) == 0
    return out


def reconstruct_and_score(dataset: Path, result: Path, truth: Path, capsys: pytest.CaptureFixture[str]) -> dict[str, object]:
    assert cli.main(["reconstruct", str(dataset), "-o", str(result), "--device", "cpu", "--voxel-mm", "0.6", "--keep-stages"]) == 0, (
        capsys.readouterr().err
    )
    assert (result / "stages" / "solid.json").is_file()
    capsys.readouterr()
    assert cli.main(["score", str(result), str(truth), "--json"]) == 0
    found: dict[str, object] = json.loads(capsys.readouterr().out)
    return found


def test_simulate_reconstruct_score(dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = reconstruct_and_score(dataset, tmp_path / "result", dataset, capsys)
    assert found["volume_true_mm3"] == pytest.approx(4.0 / 3.0 * np.pi * 1000.0, rel=0.005)
    assert found["volume_error"] == pytest.approx(0.0, abs=0.05)
    assert {"volume_mm3", "extents_error", "recall", "precision", "iou", "timings_s"} <= set(found)
    for name in ("inputs.png", "cameras.png", "shape.png", "shape_and_truth.png"):
        assert (tmp_path / "result" / "pictures" / name).stat().st_size > 5000
    assert cli.main(["score", str(tmp_path / "result"), str(dataset)]) == 0
    assert "volume" in capsys.readouterr().out
    assert [path.name for path in tmp_path.iterdir()] == ["result"]


def test_exports_open_elsewhere_and_say_the_same(dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    result = tmp_path / "result"
    assert cli.main(["reconstruct", str(dataset), "-o", str(result), "--device", "cpu", "--voxel-mm", "0.6"]) == 0
    for name in ("root.stl", "root.glb", "root.ply", "root.nrrd", "cameras.json", "colmap"):
        words = ["export", str(result), "-o", str(tmp_path / name), "--dataset", str(dataset)]
        assert cli.main(words) == 0, capsys.readouterr().err
        assert cli.main(words) == 2  # never over a file that is there
    volume = json.loads((result / "result.json").read_text())["volume_mm3"]
    surface = trimesh.load_mesh(result / "shape.ply")
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

    views = {view["file"]: np.array(view["cam_from_canister"]) for view in json.loads((result / "result.json").read_text())["views"]}
    read = read_cameras(tmp_path / "cameras.json", load_dataset(dataset).scene.camera)
    assert read.camera == load_dataset(dataset).scene.camera
    for file, pose in views.items():
        np.testing.assert_allclose(read.cam_from_canister[Path(file).name], pose, atol=1e-9)
    rows = [line.split() for line in (tmp_path / "colmap" / "images.txt").read_text().splitlines() if line and not line.startswith("#")]
    assert [row[-1] for row in rows] == list(views)
    w, x, y, z, *shift = (float(value) for value in rows[3][1:8])
    np.testing.assert_allclose(Rotation.from_quat([x, y, z, w]).as_matrix(), views[rows[3][-1]][:3, :3], atol=1e-9)
    np.testing.assert_allclose(shift, views[rows[3][-1]][:3, 3], atol=1e-9)
    capsys.readouterr()
    assert cli.main(["export", str(result), "-o", str(tmp_path / "other.json")]) == 2
    assert "--dataset" in capsys.readouterr().err
    assert cli.main(["export", str(result), "-o", str(tmp_path / "root.xyz")]) == 2
    assert ".stl" in capsys.readouterr().err


def test_the_truth_changes_nothing_in_the_result(dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    blind = tmp_path / "blind"
    shutil.copytree(dataset, blind, ignore=shutil.ignore_patterns("truth"))
    found = []
    for folder, out in ((dataset, tmp_path / "with"), (blind, tmp_path / "without")):
        words = ["reconstruct", str(folder), "-o", str(out), "--device", "cpu", "--voxel-mm", "1"]
        assert cli.main(words) == 0, capsys.readouterr().err
        summary = json.loads((out / "result.json").read_text())
        for key in ("dataset", "timings_s", "peak_memory_mib"):
            del summary[key]
        found.append((summary, *((out / name).read_bytes() for name in ("shape.npz", "shape.ply"))))
    assert found[0] == found[1]
    assert (tmp_path / "with" / "pictures" / "shape_and_truth.png").exists()
    assert not (tmp_path / "without" / "pictures" / "shape_and_truth.png").exists()


def test_import_of_masks_with_cameras_gives_the_same_shape(dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The true silhouettes and cameras, in nerfstudio's form, lead to the true volume: axes, pixel centres and frames agree."""
    scene, truth = load_dataset(dataset).scene, load_truth(dataset)
    files.save_scene(scene, tmp_path / "rig.toml")
    poses = []
    for view in truth.views:
        world_from_gl = frames.invert(np.array(view.cam_from_canister)) @ np.diag([1.0, -1.0, -1.0, 1.0])
        poses.append({"file_path": view.file, "transform_matrix": world_from_gl.tolist()})
    (fx, fy), (cx, cy), (w, h) = scene.camera.focal_px, scene.camera.principal_px, scene.camera.image_wh
    lens = {"fl_x": fx, "fl_y": fy, "cx": cx + 0.5, "cy": cy + 0.5, "w": w, "h": h}
    (tmp_path / "transforms.json").write_text(json.dumps({**lens, "frames": poses}))
    masks, cameras, out = dataset / "truth" / "masks", tmp_path / "transforms.json", tmp_path / "dataset"
    words = ["import", str(masks), "--scene", str(tmp_path / "rig.toml"), "--cameras", str(cameras), "--masks", "-o", str(out)]
    assert cli.main(words) == 0, capsys.readouterr().err
    shutil.copytree(dataset / "truth", out / "truth")
    found = reconstruct_and_score(out, tmp_path / "result", out, capsys)
    assert found["volume_error"] == pytest.approx(0.0, abs=0.03)
    assert found["iou"] > 0.93


@dataclass(frozen=True)
class Damage:
    """What is wrong with a dataset, and what the complaint must name."""

    name: str
    spoil: Callable[[Path], object]
    named: str


def _rewrite(path: Path, old: str, new: str) -> None:
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new), encoding="utf-8")


DAMAGES = [
    Damage("missing picture", lambda d: (d / "images/view_003.png").unlink(), "view_003.png"),
    Damage(
        "truncated picture",
        lambda d: (d / "images/view_003.png").write_bytes((d / "images/view_004.png").read_bytes()[:999]),
        "view_003.png",
    ),
    Damage("no picture", lambda d: (d / "images/view_003.png").write_text("hello"), "view_003.png"),
    Damage("another picture", lambda d: shutil.copy(d / "images/view_004.png", d / "images/view_003.png"), "view_003.png"),
    Damage("unknown version", lambda d: _rewrite(d / "dataset.json", '"schema_version": 1', '"schema_version": 99'), "99"),
    Damage("manifest cut short", lambda d: (d / "dataset.json").write_text('{"schema_version": 1,'), "dataset.json"),
    Damage("no manifest", lambda d: (d / "dataset.json").unlink(), "dataset.json"),
    Damage("unknown key", lambda d: _rewrite(d / "dataset.json", '"level_mm"', '"levle_mm"'), "levle_mm"),
    Damage("markers of another strip", lambda d: _rewrite(d / "dataset.json", '"first_id": 0', '"first_id": 100'), "another strip"),
]


@pytest.mark.parametrize("damage", DAMAGES, ids=lambda damage: damage.name)
def test_damaged_dataset_is_named(damage: Damage, dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    copy = tmp_path / "dataset"
    shutil.copytree(dataset, copy, ignore=shutil.ignore_patterns("truth"))
    damage.spoil(copy)
    assert cli.main(["reconstruct", str(copy), "-o", str(tmp_path / "result"), "--device", "cpu"]) == cli.EXIT_MISTAKE
    said = [line for line in capsys.readouterr().err.splitlines() if line.startswith("rhizotwin: ")]
    assert len(said) == 1
    assert damage.named in said[0]
    assert [path.name for path in tmp_path.iterdir()] == ["dataset"]


@pytest.mark.parametrize(
    ("name", "named"),
    [("open.stl", "not closed"), ("outside.ply", "leaves the water"), ("empty.obj", "empty.obj"), ("text.stl", "text.stl")],
)
def test_bad_specimen_is_named(name: str, named: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / name
    ball = trimesh.creation.icosphere(subdivisions=2, radius=10.0)
    ball.apply_translation((90.0 if name.startswith("outside") else 0.0, 0.0, -60.0))
    if name.startswith("open"):
        ball.update_faces(np.arange(len(ball.faces)) > 3)
    if name.startswith(("empty", "text")):
        path.write_text("" if name.startswith("empty") else "this is no mesh")
    else:
        ball.export(path)
    out = tmp_path / "out"
    assert cli.main(["simulate", "sphere_20mm", "--specimen", str(path), "-o", str(out), "--device", "cpu"]) == cli.EXIT_MISTAKE
    said = capsys.readouterr().err.splitlines()
    assert len(said) == 1
    assert named in said[0]
    assert not out.exists()


def test_no_llvm_is_said_with_the_command_to_type(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from rhizotwin import engine

    monkeypatch.delenv("DRJIT_LIBLLVM_PATH", raising=False)
    monkeypatch.setattr(engine, "usual_folders", lambda: [tmp_path])
    assert cli.main(["simulate", "sphere_20mm", "-o", str(tmp_path / "out"), "--device", "cpu"]) == cli.EXIT_MISTAKE
    said = capsys.readouterr().err
    assert "LLVM" in said
    assert "install" in said
    assert not (tmp_path / "out").exists()
