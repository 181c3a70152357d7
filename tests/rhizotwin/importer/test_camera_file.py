"""Cameras of other programs: axes, pixel centres, lens models, ambiguous keys, and pictures with lenses of their own."""

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from rhizotwin.importer.colmap_model import read_colmap
from rhizotwin.importer.given_cameras import common_camera
from rhizotwin.importer.given_lens import Lens
from rhizotwin.importer.picture_import import PictureKind, import_pictures
from rhizotwin.scenes import files, frames
from rhizotwin.scenes.dataset import read_image
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Camera
from tests.rhizotwin.importer.test_import import WH, write_cameras, write_pictures

POINT_MM = np.array([12.0, -7.0, -35.0])
CORPUS = Path(__file__).parents[2] / "fuzz" / "corpus"
SCENE = replace(files.load_scene("sphere_20mm"), camera=files.load_scene("sphere_20mm").camera.resized(WH))


def write(path: Path, top: dict[str, Any], own: list[dict[str, Any]]) -> list[np.ndarray]:
    """Write a transforms.json with changed keys at the top and in its frames, and return the pixels of `POINT_MM`.

    The pixels are those of OpenCV's functions, by the conventions of the file.
    """
    given = json.loads(write_cameras(path, [f"{k}.png" for k in range(len(own))], **top).read_text())
    applied, found = np.vstack([given.get("applied_transform", np.eye(4)[:3]), [0, 0, 0, 1]]), []
    for frame, keys in zip(given["frames"], own, strict=True):
        pose = np.diag([1.0, -1, -1, 1]) @ np.linalg.inv(np.array(frame["transform_matrix"]))
        frame |= keys | {"transform_matrix": (applied @ np.array(frame["transform_matrix"])).tolist()}
        lens = {"fl_x": 100.0, "cx": 32.0, "cy": 24.0} | given | frame
        k1, k2, k3, k4, p1, p2 = lens.get("distortion_params") or [lens.get(key, 0.0) for key in ("k1", "k2", "k3", "k4", "p1", "p2")]
        matrix = np.array([[lens["fl_x"], 0, lens["cx"]], [0, lens.get("fl_y", lens["fl_x"]), lens["cy"]], [0, 0, 1.0]])
        at = POINT_MM[None, None], cv2.Rodrigues(pose[:3, :3])[0], pose[:3, 3], matrix
        if lens.get("is_fisheye") or lens.get("camera_model") == "OPENCV_FISHEYE":
            px, _ = cv2.fisheye.projectPoints(*at, np.array([k1, k2, k3, k4]))
        else:
            px, _ = cv2.projectPoints(*at, np.array([k1, k2, p1, p2, k3, k4, lens.get("k5", 0.0), lens.get("k6", 0.0)]))
        found.append(px.ravel())
    path.write_text(json.dumps(given))
    return found


def pixel(camera: Camera, cam_from_canister: Any) -> np.ndarray:
    """Return the pixel of `POINT_MM`, with centres at integers."""
    x, y, z = frames.apply(np.array(cam_from_canister), POINT_MM)
    return Lens.of(camera).pixels(np.array([[x / z, y / z]]))[0]


FISHEYE = {"k1": 0.03, "k2": 0.005, "k3": 0.001, "k4": -0.0005}
RADIAL = {"k1": -0.1, "k2": 0.05, "camera_model": "RADIAL", "fl_x": 99.0}
ANGLE = {"camera_angle_x": 2.0 * np.arctan(0.32), "fl_x": None, "fl_y": None, "k1": None}
NO_LENS = {"k1": None, "camera_model": None, "fl_x": None, "fl_y": None, "cx": None}
LENSES: dict[str, tuple[dict[str, Any], dict[str, Any], list[str]]] = {
    "ordinary": ({"p1": 0.001, "p2": -0.002, "k3": 0.02}, {}, []),
    "applied transform": ({"applied_transform": [[0.0, 1.0, 0.0, 5.0], [1.0, 0.0, 0.0, 6.0], [0.0, 0.0, -1.0, 7.0]]}, {}, []),
    "fisheye of instant-ngp": ({**FISHEYE, "is_fisheye": True, "camera_model": None}, {}, ["fisheye lens replaced"]),
    "fisheye per frame": (NO_LENS, {**FISHEYE, "camera_model": "OPENCV_FISHEYE", "fl_x": 99.0, "cx": 31.0}, ["fisheye lens replaced"]),
    "radial per frame": (NO_LENS, {**RADIAL, "cx": 31.0}, []),
    "simple radial": ({"camera_model": "SIMPLE_RADIAL", "k1": -0.1}, {}, []),
    "list of coefficients": ({"k1": None, "distortion_params": [-0.1, 0.05, 0.0, 0.0, 0.001, -0.002]}, {}, []),
    "rational": ({"camera_model": "FULL_OPENCV", "k1": 0.1, "k4": 0.12, "k5": -0.01, "k6": 0.001}, {}, ["k6 replaced"]),
    "angle of view": ({**ANGLE, "w": None, "h": None, "cx": None, "cy": None}, {}, ["that of the scene", "the centre"]),
    "harmless keys": ({"aabb_scale": 16, "rolling_shutter": [0.0, 0, 0], "scan": 7, "mask_path": "m"}, {}, ["not used: mask_path, scan"]),
}


@pytest.mark.parametrize(("top", "own", "said"), LENSES.values(), ids=LENSES)
def test_keys_have_their_meaning(top: dict[str, Any], own: dict[str, Any], said: list[str], tmp_path: Path) -> None:
    """A point's pixel by our dataset equals the one by the file's own rules: OpenGL axes, pixel corners at integers."""
    expected = write(tmp_path / "t.json", top, [own, own])
    made = import_pictures(
        write_pictures(tmp_path / "in", "0.png", "1.png"), SCENE, tmp_path / "out", kind=PictureKind(cameras=tmp_path / "t.json")
    )
    found = [pixel(made.dataset.scene.camera, frame.cam_from_canister) + 0.5 for frame in made.dataset.frames]
    np.testing.assert_allclose(found, expected, atol=1e-3)
    notes = [note for note in made.notes if "response curve" not in note]
    assert len(notes) == len(said)
    assert all(part in " ".join(notes) for part in said)


@pytest.mark.parametrize("kind", ["bin", "txt"])
def test_colmap_models_project_like_colmap(kind: str, tmp_path: Path) -> None:
    """Files of pycolmap 4.2.1, in which two cameras form one rig; pixels by its Image.project_point."""
    folder = shutil.copytree(CORPUS / f"colmap_{kind}", tmp_path / "sparse" / "0")
    given = read_colmap(folder, Camera())
    for name, px in {"a.png": [30.19578294, 22.69850684], "b.png": [29.6900022, 22.92380058]}.items():
        x, y, z = frames.apply(given.pictures[name].cam_from_canister, POINT_MM)
        np.testing.assert_allclose(given.pictures[name].lens.pixels(np.array([[x / z, y / z]]))[0] + 0.5, px, atol=1e-6)
    with pytest.raises(UserError, match=r"give .*sparse.0 instead"):
        read_colmap(tmp_path, Camera())
    cameras, images = (folder / f"{name}.{kind}" for name in ("cameras", "images"))
    images.write_bytes(images.read_bytes()[:-1].replace(b"a.png\n\n", b"a.png\n"))
    with pytest.raises(UserError, match=r"truncated or damaged|line 6: this line must list the points of left/a\.png"):
        read_colmap(folder, Camera())
    cameras.write_bytes(cameras.read_bytes().replace(b"OPENCV_FISHEYE", b"FOV").replace(b"\x05\0\0\0\x40", b"\x07\0\0\0\x40"))
    with pytest.raises(UserError, match=r"lens model (FOV|with the number 7) is not supported"):
        read_colmap(folder, Camera())


@pytest.mark.parametrize("masks", [False, True])
def test_pictures_with_other_lenses_are_resampled(masks: bool, tmp_path: Path) -> None:
    """A dot drawn where each lens shows a point is where the dataset's camera projects it."""
    own = [{"fl_x": 100.0 + 4.0 * k, "k1": -0.1 * k, "cx": 32.0 + k} for k in range(3)]
    own[2] |= {"camera_model": "OPENCV_FISHEYE", "k1": 0.3}
    rows, columns = np.mgrid[0 : WH[1], 0 : WH[0]] + 0.5
    (tmp_path / "in").mkdir()
    for k, (u, v) in enumerate(write(tmp_path / "t.json", NO_LENS, own)):
        dot = np.exp(-0.5 * ((columns - u) ** 2 + (rows - v) ** 2) / 1.5**2)
        cv2.imwrite(str(tmp_path / "in" / f"{k}.png"), 250.0 * (np.clip(3.0 * dot - 0.5, 0.0, 1.0) if masks else 0.2 + 0.8 * dot))
    made = import_pictures(tmp_path / "in", SCENE, tmp_path / "out", kind=PictureKind(cameras=tmp_path / "t.json", masks=masks))
    camera, pictures = made.dataset.scene.camera, [read_image(made.dataset, frame).astype(float) for frame in made.dataset.frames]
    assert f"{camera.image_wh[0]}x{camera.image_wh[1]} px" in next(note for note in made.notes if "3 different lenses" in note)
    i, j = np.meshgrid(*(np.arange(side) for side in camera.image_wh))
    dots = [np.maximum(picture - 1.1 * np.median(picture), 0.0) for picture in pictures]
    found = [[np.average(i, weights=dot), np.average(j, weights=dot)] for dot in dots]
    np.testing.assert_allclose(found, [pixel(camera, frame.cam_from_canister) for frame in made.dataset.frames], atol=0.05)


def test_a_wide_fisheye_becomes_a_pinhole_camera() -> None:
    lens = Lens(image_wh=(1600, 1600), focal_px=(509.0, 509.0), principal_px=(799.5, 799.5), is_fisheye=True)  # 180 degrees
    camera = common_camera({"a": lens}, Camera())
    assert camera.distortion == (0.0,) * 5
    assert np.rad2deg(np.arctan(camera.image_wh[0] / 2.0 / camera.focal_px[0])) == pytest.approx(65.0, abs=0.1)
    with pytest.raises(UserError, match="the lens of b differs too much"):
        common_camera({"a": lens, "b": replace(lens, focal_px=(800.0, 800.0))}, Camera())


POSE = frames.translation(400.0, 0.0, 0.0)
BAD_CAMERAS: dict[str, tuple[dict[str, Any], dict[str, Any], str]] = {
    "panorama": ({"camera_model": "EQUIRECTANGULAR"}, {}, "camera_model 'EQUIRECTANGULAR'"),
    "fisheye or not": ({"is_fisheye": True}, {}, "camera_model is OPENCV, but is_fisheye is true"),
    "no focal length": ({"fl_x": None, "fl_y": None}, {}, "fl_x is missing"),
    "other focal length": ({"camera_angle_x": 0.5}, {}, "fl_x means 100 px, but camera_angle_x means 125.322 px"),
    "lens that folds the picture": ({"k1": -9.0}, {}, "[camera] distortion"),
    "k4": ({"k4": 0.1}, {}, "k4 is not supported"),
    "coefficient of another model": ({"camera_model": "PINHOLE"}, {}, "k1 is not supported for camera_model PINHOLE"),
    "f-theta": ({"ftheta_p0": 0.1}, {}, "ftheta_p0 means an f-theta lens"),
    "rolling shutter": ({}, {"rolling_shutter": [0.0, 0.0, 1.0]}, "a rolling shutter"),
    "scaled world": ({"applied_scale": 0.5}, {}, "applied_scale must be 1"),
    "mirrored world": ({"applied_transform": np.diag([1.0, 1.0, -1.0, 1.0])[:3].tolist()}, {}, "mirroring"),
    "two lenses": ({}, {"fl_x": 2.0}, "frames[0]: fl_x is 2.0, but 100.0 at the top"),
    "scaled pose": ({}, {"transform_matrix": (2 * np.eye(4)).tolist()}, "frames[0]"),
    "metres": ({}, {"transform_matrix": frames.translation(0.4, 0.0, -0.04).tolist()}, "inside"),
    "other axes": ({}, {"transform_matrix": POSE.tolist()}, "does not show the canister"),
    "unknown picture": ({}, {"file_path": "z.png"}, "z.png"),
}


@pytest.mark.parametrize(("top", "own", "named"), BAD_CAMERAS.values(), ids=BAD_CAMERAS)
def test_bad_cameras_are_refused_by_name(top: dict[str, Any], own: dict[str, Any], named: str, tmp_path: Path) -> None:
    given = json.loads(write_cameras(tmp_path / "t.json", ["a.png"], **top).read_text())
    given["frames"][0] |= own
    (tmp_path / "t.json").write_text(json.dumps(given))
    with pytest.raises(UserError) as refused:
        import_pictures(write_pictures(tmp_path / "in", "a.png"), SCENE, tmp_path / "out", kind=PictureKind(cameras=tmp_path / "t.json"))
    assert named in str(refused.value)
    assert str(tmp_path / "t.json") in str(refused.value)
    assert not (tmp_path / "out").exists()
