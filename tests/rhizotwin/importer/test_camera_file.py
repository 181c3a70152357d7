"""Cameras of other programs: axes, pixel centres, lens models, ambiguous keys, and pictures with lenses of their own."""

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from rhizotwin.given_lens import Lens, common_camera
from rhizotwin.importer.colmap_model import read_colmap
from rhizotwin.importer.picture_import import import_pictures
from rhizotwin.nerfstudio import read_cameras
from rhizotwin.scenes import files, frames
from rhizotwin.scenes.dataset import read_image
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Camera, Scene
from tests.rhizotwin.importer.test_import import WH, write_cameras, write_pictures

POINT_MM = np.array([12.0, -7.0, -35.0])
CORPUS = Path(__file__).parents[2] / "fuzz" / "corpus"


@pytest.fixture(scope="module")
def scene() -> Scene:
    given = files.load_scene("sphere_20mm")
    return replace(given, camera=given.camera.resized(WH))


def pixel(camera: Camera, cam_from_canister: Any) -> np.ndarray:
    """Return the pixel of `POINT_MM` by OpenCV."""
    pose, matrix = np.array(cam_from_canister), np.array([[camera.focal_px[0], 0, 0], [0, camera.focal_px[1], 0], [0, 0, 1.0]])
    matrix[:2, 2] = camera.principal_px
    px, _ = cv2.projectPoints(POINT_MM[None], cv2.Rodrigues(pose[:3, :3])[0], pose[:3, 3], matrix, np.array(camera.distortion))
    return np.asarray(px.ravel())


def test_given_cameras_project_like_opencv(tmp_path: Path, scene: Scene) -> None:
    """A point's pixel by our dataset equals the one by the file's own rules: OpenGL axes, pixel corners at integers."""
    names = ["a.png", "b.png", "c.png"]
    cameras = write_cameras(tmp_path / "transforms.json", names, p1=0.001)
    made = import_pictures(write_pictures(tmp_path / "in", *names), scene, tmp_path / "out", cameras=cameras)
    file = json.loads(cameras.read_text())
    assert [frame.table_deg for frame in made.dataset.frames] == [None] * 3
    for frame, pose in zip(made.dataset.frames, file["frames"], strict=True):
        x, y, z = (np.linalg.inv(np.array(pose["transform_matrix"])) @ [*POINT_MM, 1.0])[:3]
        u, v = x / -z, y / -z
        r2 = u * u + v * v
        radial = 1.0 + file["k1"] * r2
        # v is upwards in OpenGL's axes
        expected = [
            file["fl_x"] * (u * radial - 2.0 * file["p1"] * u * v) + file["cx"],
            file["fl_y"] * (-v * radial + file["p1"] * (r2 + 2.0 * v * v)) + file["cy"],
        ]
        np.testing.assert_allclose(pixel(made.dataset.scene.camera, frame.cam_from_canister) + 0.5, expected, atol=1e-9)


FISHEYE = {"k1": 0.03, "k2": 0.005, "k3": 0.001, "k4": -0.0005}
RADIAL = {"k1": -0.1, "k2": 0.05}
ANGLE = {"camera_angle_x": 2.0 * np.arctan(0.32), "fl_x": None, "fl_y": None, "k1": None}
SAME_LENSES: dict[str, tuple[dict[str, Any], dict[str, Any], tuple[str, ...]]] = {
    "fisheye of instant-ngp": ({**FISHEYE, "is_fisheye": True, "camera_model": None}, {}, ("fisheye lens replaced",)),
    "fisheye per frame": ({"k1": None, "camera_model": None}, {**FISHEYE, "camera_model": "OPENCV_FISHEYE"}, ("fisheye lens replaced",)),
    "radial per frame": ({"k1": None, "camera_model": None, "fl_x": None}, {**RADIAL, "camera_model": "RADIAL", "fl_x": 100.0}, ()),
    "simple radial": ({"camera_model": "SIMPLE_RADIAL", "k1": -0.1}, {}, ()),
    "list of coefficients": ({"k1": None, "distortion_params": [-0.1, 0.05, 0.0, 0.0, 0.001, -0.002]}, {}, ()),
    "rational": ({"camera_model": "FULL_OPENCV", "k1": 0.1, "k4": 0.12, "k5": -0.01, "k6": 0.001}, {}, ("k6 replaced",)),
    "angle of view": ({**ANGLE, "w": None, "h": None, "cx": None, "cy": None}, {}, ("that of the scene", "the centre")),
    "harmless keys": ({"aabb_scale": 16, "rolling_shutter": [0.0, 0, 0], "scan": 7, "mask_path": "m"}, {}, ("not used: mask_path, scan",)),
}


@pytest.mark.parametrize(("top", "own", "said"), SAME_LENSES.values(), ids=SAME_LENSES)
def test_keys_of_the_lens_have_their_meaning(
    top: dict[str, Any], own: dict[str, Any], said: tuple[str, ...], tmp_path: Path, scene: Scene
) -> None:
    cameras = write_cameras(tmp_path / "transforms.json", ["a.png"], **top)
    given = json.loads(cameras.read_text())
    given["frames"][0] |= own
    cameras.write_text(json.dumps(given))
    made = import_pictures(write_pictures(tmp_path / "in", "a.png"), scene, tmp_path / "out", cameras=cameras)
    lens = {"fl_x": 100.0, "cx": 32.0, "cy": 24.0} | given | own
    rotation, shift = cv2.Rodrigues(np.array(made.dataset.frames[0].cam_from_canister)[:3, :3])[0], made.dataset.frames[0].cam_from_canister
    matrix = np.array([[lens["fl_x"], 0, lens["cx"]], [0, lens.get("fl_y", lens["fl_x"]), lens["cy"]], [0, 0, 1.0]])
    k1, k2, k3, k4, p1, p2 = lens.get("distortion_params") or [lens.get(key, 0.0) for key in ("k1", "k2", "k3", "k4", "p1", "p2")]
    where = POINT_MM[None, None], rotation, np.array(shift)[:3, 3], matrix
    if "fisheye" in " ".join(said):
        px, _ = cv2.fisheye.projectPoints(*where, np.array([k1, k2, k3, k4]))
    else:
        px, _ = cv2.projectPoints(*where, np.array([k1, k2, p1, p2, k3, k4, lens.get("k5", 0.0), lens.get("k6", 0.0)]))
    np.testing.assert_allclose(pixel(made.dataset.scene.camera, shift) + 0.5, px.ravel(), atol=1e-3)
    notes = [note for note in made.notes if "response curve" not in note]
    assert len(notes) == len(said)
    assert all(part in " ".join(notes) for part in said)


@pytest.mark.parametrize("kind", ["bin", "txt"])
def test_colmap_models_project_like_colmap(kind: str, tmp_path: Path) -> None:
    """Files of pycolmap 4.2.1, in which two cameras form one rig; pixels by its Image.project_point."""
    folder = shutil.copytree(CORPUS / f"colmap_{kind}", tmp_path / "model")
    given = read_colmap(folder, Camera())
    expected = {"a.png": [30.19578294, 22.69850684], "b.png": [29.6900022, 22.92380058]}
    for name, px in expected.items():
        x, y, z = frames.apply(given.cam_from_canister[name], POINT_MM)
        np.testing.assert_allclose(given.lenses[name].pixels(np.array([[x / z, y / z]]))[0] + 0.5, px, atol=1e-6)
    assert given.is_resampled
    with pytest.raises(UserError, match=r"give .*sparse.0 instead"):
        read_colmap(shutil.copytree(folder, tmp_path / "project" / "sparse" / "0").parents[1], Camera())
    for old, new in ((b"OPENCV_FISHEYE", b"THIN_PRISM_FISHEYE"), (b"\x05\0\0\0\x40", b"\x0a\0\0\0\x40")):
        path = folder / f"cameras.{kind}"
        path.write_bytes(path.read_bytes().replace(old, new))
    with pytest.raises(UserError, match=r"lens model (THIN_PRISM_FISHEYE|with the number 10) is not supported"):
        read_colmap(folder, Camera())


def test_text_models_need_a_line_of_points(tmp_path: Path) -> None:
    folder = shutil.copytree(CORPUS / "colmap_txt", tmp_path / "model")
    text = (folder / "images.txt").read_text()
    (folder / "images.txt").write_text(text.replace("a.png\n\n", "a.png\n"))
    with pytest.raises(UserError, match=r"line 6: this line must list the points of left/a\.png"):
        read_colmap(folder, Camera())


LENSES = {
    "ordinary": Lens(
        image_wh=(80, 60), focal_px=(70.0, 71.0), principal_px=(40.0, 29.0), distortion=(-0.1, 0.05, 0.001, -0.002, 0.02, 0, 0, 0)
    ),
    "rational": Lens(image_wh=(80, 60), focal_px=(70.0, 71.0), principal_px=(40.0, 29.0), distortion=(8.0, 5.0, 0, 0, 0.3, 8.2, 6.0, 1.0)),
    "fisheye": Lens(
        image_wh=(80, 60),
        focal_px=(40.0, 41.0),
        principal_px=(40.0, 29.0),
        distortion=(0.04, 0.01, 0, 0, -0.003, 0.001, 0, 0),
        is_fisheye=True,
    ),
}


@pytest.mark.parametrize("lens", LENSES.values(), ids=LENSES)
def test_rays_are_those_of_opencv_and_come_back(lens: Lens) -> None:
    px = np.stack(np.meshgrid(np.linspace(0, 79, 9), np.linspace(0, 59, 7)), axis=-1).reshape(-1, 2)
    rays = lens.rays(px)
    matrix = np.array([[lens.focal_px[0], 0, 40.0], [0, lens.focal_px[1], 29.0], [0, 0, 1.0]])
    k1, k2, _, _, k3, k4, _, _ = lens.distortion
    at = np.column_stack([rays, np.ones(len(rays))])[:, None], np.zeros(3), np.zeros(3), matrix
    back, _ = (
        cv2.fisheye.projectPoints(*at, np.array([k1, k2, k3, k4])) if lens.is_fisheye else cv2.projectPoints(*at, np.array(lens.distortion))
    )
    np.testing.assert_allclose(back.reshape(-1, 2), px, atol=1e-6)


@pytest.mark.parametrize("masks", [False, True])
def test_pictures_with_other_lenses_are_resampled(masks: bool, tmp_path: Path, scene: Scene) -> None:
    """A dot drawn where each lens shows a point is where the dataset's camera projects it, and what is cut off is told."""
    own = [{"fl_x": 100.0 + 4.0 * k, "k1": -0.1 * k, "cx": 32.0 + k} for k in range(3)]
    own[2] |= {"camera_model": "OPENCV_FISHEYE", "k1": 0.3}
    cameras = write_cameras(tmp_path / "t.json", ["a.png", "b.png", "c.png"], camera_model=None, fl_x=None, fl_y=None, cx=None, k1=None)
    given = json.loads(cameras.read_text())
    given["frames"] = [frame | lens for frame, lens in zip(given["frames"], own, strict=True)]
    cameras.write_text(json.dumps(given))
    read = read_cameras(cameras, scene.camera)
    (tmp_path / "in").mkdir()
    rows, columns = np.mgrid[0 : WH[1], 0 : WH[0]]
    for name, pose in read.cam_from_canister.items():
        x, y, z = frames.apply(pose, POINT_MM)
        u, v = read.lenses[name].pixels(np.array([[x / z, y / z]]))[0]
        dot = np.exp(-0.5 * ((columns - u) ** 2 + (rows - v) ** 2) / 1.5**2)
        cv2.imwrite(str(tmp_path / "in" / name), (250.0 * (dot if not masks else np.clip(3.0 * dot - 0.5, 0.0, 1.0))).astype(np.uint8))
    made = import_pictures(tmp_path / "in", scene, tmp_path / "out", cameras=cameras, masks=masks)
    camera = made.dataset.scene.camera
    assert "3 different lenses" in " ".join(made.notes)
    assert f"{camera.image_wh[0]}x{camera.image_wh[1]} px" in " ".join(made.notes)
    off = []
    for frame in made.dataset.frames:
        picture = read_image(made.dataset, frame).astype(float)
        j, i = np.mgrid[0 : picture.shape[0], 0 : picture.shape[1]]
        off.append(np.array([(i * picture).sum(), (j * picture).sum()]) / picture.sum() - pixel(camera, frame.cam_from_canister))
    assert np.abs(off).max() < 0.05


def test_a_wide_fisheye_becomes_a_pinhole_camera() -> None:
    lens = Lens(image_wh=(1600, 1600), focal_px=(509.0, 509.0), principal_px=(799.5, 799.5), is_fisheye=True)  # 180 degrees
    camera = common_camera({"a": lens}, Camera())
    assert camera.distortion == (0.0,) * 5
    half_deg = np.rad2deg(np.arctan(camera.image_wh[0] / 2.0 / camera.focal_px[0]))
    assert half_deg == pytest.approx(65.0, abs=0.1)
    with pytest.raises(UserError, match="the lens of b differs too much"):
        common_camera({"a": lens, "b": replace(lens, focal_px=(800.0, 800.0))}, Camera())


def test_applied_transform_is_taken_back(tmp_path: Path) -> None:
    plain = read_cameras(write_cameras(tmp_path / "a.json", ["a.png", "b.png"]), Camera())
    applied = np.array([[0.0, 1.0, 0.0, 5.0], [1.0, 0.0, 0.0, 6.0], [0.0, 0.0, -1.0, 7.0]])
    file = json.loads((tmp_path / "a.json").read_text())
    for frame in file["frames"]:
        frame["transform_matrix"] = (np.vstack([applied, [0, 0, 0, 1]]) @ np.array(frame["transform_matrix"])).tolist()
    (tmp_path / "b.json").write_text(json.dumps(file | {"applied_transform": applied.tolist()}))
    moved = read_cameras(tmp_path / "b.json", Camera())
    assert list(moved.cam_from_canister) == list(plain.cam_from_canister) == ["a.png", "b.png"]
    np.testing.assert_allclose(*(list(read.cam_from_canister.values()) for read in (moved, plain)), atol=1e-9)


def frame(file: str = "a.png", pose: Any = None, **more: Any) -> dict[str, Any]:
    """Return a change of a transforms.json that leaves one frame, 400 mm from the axis unless another pose is given."""
    matrix = frames.translation(400.0, 0.0, 0.0).tolist() if pose is None else pose
    return {"frames": [{"file_path": file, "transform_matrix": matrix, **more}]}


BAD_CAMERAS: dict[str, tuple[dict[str, Any], str]] = {
    "panorama": ({"camera_model": "EQUIRECTANGULAR"}, "camera_model 'EQUIRECTANGULAR'"),
    "fisheye or not": ({"is_fisheye": True}, "camera_model is OPENCV, but is_fisheye is true"),
    "no focal length": ({"fl_x": None, "fl_y": None}, "fl_x is missing"),
    "other focal length": ({"camera_angle_x": 0.5}, "fl_x means 100 px, but camera_angle_x means 125.322 px"),
    "lens that folds the picture": ({"k1": -9.0}, "[camera] distortion"),
    "k4": ({"k4": 0.1}, "k4 is not supported"),
    "coefficient of another model": ({"camera_model": "PINHOLE"}, "k1 is not supported for camera_model PINHOLE"),
    "f-theta": ({"ftheta_p0": 0.1}, "ftheta_p0 means an f-theta lens"),
    "rolling shutter": (frame(rolling_shutter=[0.0, 0.0, 1.0]), "a rolling shutter"),
    "scaled world": ({"applied_scale": 0.5}, "applied_scale must be 1"),
    "mirrored world": ({"applied_transform": np.diag([1.0, 1.0, -1.0, 1.0])[:3].tolist()}, "mirroring"),
    "two lenses": (frame(fl_x=2.0), "frames[0]: fl_x is 2.0, but 100.0 at the top"),
    "scaled pose": (frame(pose=(2 * np.eye(4)).tolist()), "frames[0]"),
    "metres": (frame(pose=frames.translation(0.4, 0.0, -0.04).tolist()), "inside"),
    "other axes": (frame(), "does not show the canister"),
}


@pytest.mark.parametrize(("changed", "named"), BAD_CAMERAS.values(), ids=BAD_CAMERAS)
def test_bad_cameras_are_refused_by_name(changed: dict[str, Any], named: str, tmp_path: Path, scene: Scene) -> None:
    cameras = write_cameras(tmp_path / "transforms.json", ["a.png"], **changed)
    with pytest.raises(UserError) as refused:
        import_pictures(write_pictures(tmp_path / "in", "a.png"), scene, tmp_path / "out", cameras=cameras)
    assert named in str(refused.value)
    assert str(cameras) in str(refused.value)
    assert not (tmp_path / "out").exists()


def test_a_camera_without_its_picture_is_named(tmp_path: Path, scene: Scene) -> None:
    with pytest.raises(UserError, match=r"z\.png"):
        import_pictures(
            write_pictures(tmp_path / "in", "a.png"), scene, tmp_path / "out", cameras=write_cameras(tmp_path / "t.json", ["z.png"])
        )
