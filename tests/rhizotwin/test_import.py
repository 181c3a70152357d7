"""Pictures from elsewhere: order, sizes, silhouettes, and the two conventions of given cameras (axes, pixel centres)."""

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from rhizotwin import cli
from rhizotwin.importer import import_pictures
from rhizotwin.nerfstudio import read_cameras
from rhizotwin.picture_files import list_pictures, natural_key
from rhizotwin.scenes import files, frames, plan, transfer
from rhizotwin.scenes.atomic import write_image
from rhizotwin.scenes.dataset import load_dataset, read_image
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Camera, CapturePlan, Ring, Scene

WH = (64, 48)


@pytest.fixture
def scene() -> Scene:
    """Return a scene with a small camera and a plan of four views."""
    given_scene = files.load_scene("sphere_20mm")
    return replace(given_scene, camera=given_scene.camera.resized(WH), plan=CapturePlan(rings=(Ring(views=4, first_deg=10.0),)))


def picture(seed: int, *, wh: tuple[int, int] = WH, bits: int = 8) -> np.ndarray[Any, Any]:
    rng = np.random.default_rng(seed)
    return rng.integers(0, 2**bits, (wh[1], wh[0])).astype(np.uint8 if bits == 8 else np.uint16)


def write_pictures(folder: Path, *names: str) -> Path:
    folder.mkdir()
    for seed, name in enumerate(names):
        assert cv2.imwrite(str(folder / name), picture(seed))
    return folder


def write_cameras(path: Path, names: list[str], **changed: Any) -> Path:
    """Write a transforms.json whose cameras stand round the canister, 400 mm from the axis."""
    poses = []
    for k, name in enumerate(names):
        angle = 2.0 * np.pi * k / len(names)
        cam_from_canister = frames.level_camera(distance_mm=400.0, height_mm=-40.0, tilt_deg=5.0) @ frames.rotation_z(angle)
        gl = frames.invert(cam_from_canister) @ np.diag([1.0, -1.0, -1.0, 1.0])
        poses.append({"file_path": f"images/{name}", "transform_matrix": gl.tolist()})
    lens = {"camera_model": "OPENCV", "fl_x": 100.0, "fl_y": 101.0, "cx": 32.0, "cy": 24.0, "w": WH[0], "h": WH[1], "k1": 0.01}
    given_file = {**lens, "frames": poses} | changed
    path.write_text(json.dumps({key: value for key, value in given_file.items() if value is not None}))
    return path


def test_pictures_come_in_natural_order(tmp_path: Path, scene: Scene) -> None:
    folder = write_pictures(tmp_path / "in", "view_10.png", "view_9.png", "view_1.png", "View_2.png")
    (folder / "notes.txt").touch()
    made = import_pictures(folder, scene, tmp_path / "out")
    dataset = load_dataset(tmp_path / "out")
    assert [frame.file for frame in dataset.frames] == [f"images/{name}.png" for name in ("view_1", "View_2", "view_9", "view_10")]
    assert [frame.table_deg for frame in dataset.frames] == [view.table_deg for view in plan.views(scene)] == [10.0, 100.0, 190.0, 280.0]
    assert any("table angles" in note for note in made.notes)
    np.testing.assert_array_equal(read_image(dataset, dataset.frames[3]), picture(0))
    assert made.dataset == dataset


@given(st.lists(st.integers(0, 10**9), min_size=2, max_size=8, unique=True))
def test_natural_order_is_the_order_of_numbers(numbers: list[int]) -> None:
    paths = [Path(f"img{number}_a.png") for number in numbers]
    assert sorted(paths, key=natural_key) == [Path(f"img{number}_a.png") for number in sorted(numbers)]


def test_no_angles_are_assumed_when_the_plan_has_another_count(tmp_path: Path, scene: Scene) -> None:
    made = import_pictures(write_pictures(tmp_path / "in", "a.png", "b.png", "c.png"), scene, tmp_path / "out")
    assert [frame.table_deg for frame in made.dataset.frames] == [None] * 3


def test_every_format_is_kept_with_its_depth_and_its_word(tmp_path: Path, scene: Scene) -> None:
    folder = write_pictures(tmp_path / "in", "a.png")
    deep = picture(7, bits=16)
    cv2.imwrite(str(folder / "b.tiff"), deep, [cv2.IMWRITE_TIFF_COMPRESSION, 1])
    colour = np.full((WH[1], WH[0], 3), (10, 200, 40), np.uint8)
    cv2.imwrite(str(folder / "c.jpg"), colour)
    said = Image.Exif()
    said.get_ifd(0x8769)[0xA001] = 1  # sRGB
    Image.fromarray(picture(1)).save(folder / "d.jpg", exif=said, quality=100)
    made = import_pictures(folder, scene, tmp_path / "out")
    for name in ("a.png", "b.tiff", "c.jpg", "d.jpg"):
        assert (tmp_path / "out/images" / name).read_bytes() == (folder / name).read_bytes()
    np.testing.assert_array_equal(read_image(made.dataset, made.dataset.frames[1]), deep)
    grey = read_image(made.dataset, made.dataset.frames[2])
    assert np.abs(grey.astype(float) - (0.114 * 10 + 0.587 * 200 + 0.299 * 40)).max() < 4.0
    light = read_image(made.dataset, made.dataset.frames[3]) / 65535.0
    np.testing.assert_allclose(light, transfer.SRGB.of(picture(1) / 255.0), atol=0.03)
    assert any("sRGB" in note for note in made.notes)


@pytest.mark.parametrize("suffix", [".tif", ".png"])
def test_damage_that_no_checksum_shows_is_refused_by_its_neighbours(suffix: str, tmp_path: Path, scene: Scene) -> None:
    """Bare pixels that were overwritten; a PNG of the same pixels has a checksum that says that they are as they were taken."""
    (tmp_path / "in").mkdir()
    for k in range(6):
        grey = np.random.default_rng(k).normal(180.0, 2.0, WH[::-1]).astype(np.uint8)
        if k == 3:
            grey[20:30] = 0
        cv2.imwrite(str(tmp_path / "in" / f"v{k}{suffix}"), grey, [cv2.IMWRITE_TIFF_COMPRESSION, 1] if suffix == ".tif" else [])
    if suffix == ".tif":
        with pytest.raises(UserError, match=r"v3\.tif: rows (18|19|20) to 29 are like no other picture's.*no checksum"):
            import_pictures(tmp_path / "in", scene, tmp_path / "out")
        assert not (tmp_path / "out").exists()
        (tmp_path / "in" / "v3.tif").unlink()
    notes = import_pictures(tmp_path / "in", scene, tmp_path / "out").notes
    assert any("without a checksum" in note for note in notes) == (suffix == ".tif")


def test_given_cameras_project_like_opencv(tmp_path: Path, scene: Scene) -> None:
    """A point's pixel by our dataset equals the one by the file's own rules: OpenGL axes, pixel corners at integers."""
    names = ["a.png", "b.png", "c.png"]
    cameras = write_cameras(tmp_path / "transforms.json", names, p1=0.001)
    made = import_pictures(write_pictures(tmp_path / "in", *names), scene, tmp_path / "out", cameras=cameras)
    file = json.loads(cameras.read_text())
    point_mm = np.array([12.0, -7.0, -55.0])
    for frame, pose in zip(made.dataset.frames, file["frames"], strict=True):
        assert frame.table_deg is None
        gl_from_world = np.linalg.inv(np.array(pose["transform_matrix"]))
        x, y, z = (gl_from_world @ [*point_mm, 1.0])[:3]
        u, v = x / -z, -y / -z
        r2 = u * u + v * v
        radial = 1.0 + file["k1"] * r2
        corner_px = [
            file["fl_x"] * (u * radial + 2.0 * file["p1"] * u * v) + file["cx"],
            file["fl_y"] * (v * radial + file["p1"] * (r2 + 2.0 * v * v)) + file["cy"],
        ]
        cam_from_canister = np.array(frame.cam_from_canister)
        camera = made.dataset.scene.camera
        matrix = np.array([[camera.focal_px[0], 0, camera.principal_px[0]], [0, camera.focal_px[1], camera.principal_px[1]], [0, 0, 1.0]])
        rotation, _ = cv2.Rodrigues(cam_from_canister[:3, :3])
        px, _ = cv2.projectPoints(point_mm[None], rotation, cam_from_canister[:3, 3], matrix, np.array(camera.distortion))
        np.testing.assert_allclose(px.ravel() + 0.5, corner_px, atol=1e-9)
        assert -z > 300.0


def test_applied_transform_is_taken_back(tmp_path: Path) -> None:
    plain = read_cameras(write_cameras(tmp_path / "a.json", ["a.png", "b.png"]), Camera())
    applied = np.array([[0.0, 1.0, 0.0, 5.0], [1.0, 0.0, 0.0, 6.0], [0.0, 0.0, -1.0, 7.0]])
    file = json.loads((tmp_path / "a.json").read_text())
    for frame in file["frames"]:
        frame["transform_matrix"] = (np.vstack([applied, [0, 0, 0, 1]]) @ np.array(frame["transform_matrix"])).tolist()
    (tmp_path / "b.json").write_text(json.dumps(file | {"applied_transform": applied.tolist()}))
    moved = read_cameras(tmp_path / "b.json", Camera())
    for name, cam_from_canister in plain.cam_from_canister.items():
        np.testing.assert_allclose(moved.cam_from_canister[name], cam_from_canister, atol=1e-9)


def test_pictures_without_a_camera_are_left_out_and_named(tmp_path: Path, scene: Scene) -> None:
    cameras = write_cameras(tmp_path / "transforms.json", ["a.png", "c"])
    made = import_pictures(write_pictures(tmp_path / "in", "a.png", "b.png", "c.png"), scene, tmp_path / "out", cameras=cameras)
    assert [frame.file for frame in made.dataset.frames] == ["images/a.png", "images/c.png"]
    assert any("b.png" in note for note in made.notes)


@dataclass(frozen=True)
class BadCameras:
    """A change that spoils a transforms.json, and what the complaint must say."""

    name: str
    changed: dict[str, Any]
    said: str


BAD_CAMERAS = [
    BadCameras("fisheye", {"camera_model": "OPENCV_FISHEYE"}, "camera_model 'OPENCV_FISHEYE'"),
    BadCameras("no focal length", {"fl_x": None}, "fl_x is missing"),
    BadCameras("text for a number", {"cx": "middle"}, "cx must be a number"),
    BadCameras("negative focal length", {"fl_y": -3.0}, "must be positive"),
    BadCameras("focal length out of limits", {"fl_y": 0.5}, "[camera] focal_px element 2 = 0.5: must be between 1 and 1000000"),
    BadCameras("far principal point", {"cx": 700.0}, "[camera] principal_px element 1"),
    BadCameras("lens that folds the picture", {"k1": -9.0}, "[camera] distortion"),
    BadCameras("half pixels", {"w": 64.5}, "whole numbers"),
    BadCameras("k4", {"k4": 0.1}, "k4 is not part"),
    BadCameras("scaled world", {"applied_scale": 0.5}, "applied_scale is not 1"),
    BadCameras("mirrored world", {"applied_transform": np.diag([1.0, 1.0, -1.0, 1.0])[:3].tolist()}, "mirroring"),
    BadCameras("no frames", {"frames": []}, "no list 'frames'"),
    BadCameras("frame without a file", {"frames": [{"transform_matrix": np.eye(4).tolist()}]}, "file_path is missing"),
    BadCameras("lens per frame", {"frames": [{"file_path": "a.png", "fl_x": 2.0, "transform_matrix": []}]}, "fl_x is given for this frame"),
    BadCameras("scaled pose", {"frames": [{"file_path": "a.png", "transform_matrix": (2 * np.eye(4)).tolist()}]}, "frames[0]"),
    BadCameras("short pose", {"frames": [{"file_path": "a.png", "transform_matrix": [[1, 2], [3]]}]}, "4 rows of 4 numbers"),
    BadCameras("metres", {"frames": [{"file_path": "a.png", "transform_matrix": frames.translation(0.4, 0.0, -0.04).tolist()}]}, "inside"),
    BadCameras(
        "unknown picture", {"frames": [{"file_path": "z.png", "transform_matrix": frames.translation(400.0, 0.0, 0.0).tolist()}]}, "z.png"
    ),
]


@pytest.mark.parametrize("bad", BAD_CAMERAS, ids=lambda bad: bad.name)
def test_bad_cameras_are_refused_by_name(bad: BadCameras, tmp_path: Path, scene: Scene) -> None:
    cameras = write_cameras(tmp_path / "transforms.json", ["a.png"], **bad.changed)
    folder = write_pictures(tmp_path / "in", "a.png")
    with pytest.raises(UserError) as refused:
        import_pictures(folder, scene, tmp_path / "out", cameras=cameras)
    assert bad.said in str(refused.value)
    assert str(cameras) in str(refused.value)
    assert not (tmp_path / "out").exists()


def test_damaged_json_is_refused(tmp_path: Path) -> None:
    (tmp_path / "t.json").write_text('{"frames": [')
    with pytest.raises(UserError, match="is not JSON"):
        read_cameras(tmp_path / "t.json", Camera())


@pytest.mark.parametrize("fault", ["cut", "empty", "text", "size"])
def test_bad_picture_is_named_and_nothing_is_left(fault: str, tmp_path: Path, scene: Scene) -> None:
    folder = write_pictures(tmp_path / "in", "a.png", "b.png")
    bad = folder / "b.png"
    whole = bad.read_bytes()
    if fault == "size":
        cv2.imwrite(str(bad), picture(1, wh=(32, 48)))
    else:
        bad.write_bytes({"cut": whole[: len(whole) // 2], "empty": b"", "text": b"not a picture"}[fault])
    with pytest.raises(UserError, match=r"b\.png"):
        import_pictures(folder, scene, tmp_path / "out")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["in"]


def test_pictures_that_would_collide_are_refused(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"both a\.jpg and a\.png"):
        list_pictures(write_pictures(tmp_path / "in", "a.png", "a.jpg"))


def test_masks_of_zero_and_one_are_stretched(tmp_path: Path, scene: Scene) -> None:
    folder = tmp_path / "in"
    folder.mkdir()
    mask = np.zeros((WH[1], WH[0]), np.uint8)
    mask[10:20, 5:9] = 1
    cv2.imwrite(str(folder / "a.png"), mask)
    cameras = write_cameras(tmp_path / "transforms.json", ["a.png"])
    made = import_pictures(folder, scene, tmp_path / "out", cameras=cameras, masks=True)
    assert load_dataset(tmp_path / "out").masks
    np.testing.assert_array_equal(read_image(made.dataset, made.dataset.frames[0]), 255 * mask)


@pytest.mark.parametrize(("level", "said"), [(0, "empty"), (128, "not a silhouette")])
def test_what_is_no_silhouette_is_refused(level: int, said: str, tmp_path: Path, scene: Scene) -> None:
    folder = tmp_path / "in"
    folder.mkdir()
    grey = np.full((WH[1], WH[0]), level, np.uint8)
    if level:
        grey[:24] = 255
    cv2.imwrite(str(folder / "a.png"), grey)
    cameras = write_cameras(tmp_path / "transforms.json", ["a.png"])
    with pytest.raises(UserError, match=said):
        import_pictures(folder, scene, tmp_path / "out", cameras=cameras, masks=True)


def test_masks_without_cameras_are_refused(tmp_path: Path, scene: Scene, capsys: pytest.CaptureFixture[str]) -> None:
    files.save_scene(scene, tmp_path / "rig.toml")
    folder = write_pictures(tmp_path / "in", "a.png")
    words = ["import", str(folder), "--masks", "--scene", str(tmp_path / "rig.toml"), "-o", str(tmp_path / "out")]
    assert cli.main(words) == cli.EXIT_MISTAKE
    said = capsys.readouterr().err
    assert len(said.splitlines()) == 1
    assert "--cameras JSON" in said
    assert not (tmp_path / "out").exists()


def test_command_imports_and_says_what_it_assumed(tmp_path: Path, scene: Scene, capsys: pytest.CaptureFixture[str]) -> None:
    files.save_scene(scene, tmp_path / "rig.toml")
    folder = write_pictures(tmp_path / "in", "a.png", "b.png")
    words = ["import", str(folder), "--scene", str(tmp_path / "rig.toml"), "-o", str(tmp_path / "out")]
    assert cli.main(words) == 0
    said = capsys.readouterr().out
    assert "2 pictures" in said
    assert "no table angle is assumed" in said
    assert cli.main(words) == cli.EXIT_MISTAKE
    assert "not empty" in capsys.readouterr().err


def test_overexposed_pictures_are_said_and_recorded(tmp_path: Path, scene: Scene) -> None:
    width, height = scene.camera.image_wh
    good = np.random.default_rng(0).integers(100, 200, (height, width), dtype=np.uint8)
    clipped = good.copy()
    clipped[: height // 2] = 255
    write_image(tmp_path / "in" / "a.png", good)
    write_image(tmp_path / "in" / "b.png", clipped)
    made = import_pictures(tmp_path / "in", scene, tmp_path / "out")
    assert any("warning: 1 of 2 pictures are overexposed, images/b.png worst with 50 %" in note for note in made.notes)
    assert list(load_dataset(tmp_path / "out").origin["clipped"]) == ["images/b.png"]
