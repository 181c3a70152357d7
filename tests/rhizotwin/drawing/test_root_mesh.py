"""Roots as coloured tubes, and the exports of a result that need no reconstruction."""

import gzip
import io
import json
import zipfile
from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree as ET

import cv2
import nrrd
import numpy as np
import pytest
import tifffile
import trimesh

from rhizotwin.drawing import root_mesh
from rhizotwin.exporter import exports
from rhizotwin.scenes import atomic
from rhizotwin.scenes.dataset import file_sha256
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.rsml import Root, write_rsml
from rhizotwin.scenes.rsml_reader import read_rsml
from rhizotwin.stored import result_files
from tests.rhizotwin import plant as plants


def bent(order: int, diameter_mm: float, *, parent: int = -1) -> Root:
    turn = np.linspace(0.0, np.pi / 2.0, 60)
    points = np.stack([20.0 * np.sin(turn), 3.0 * turn * order, -20.0 * (1.0 - np.cos(turn)) - 5.0], axis=1)
    return Root(points_mm=points, diameters_mm=np.full(60, diameter_mm), order=order, parent=parent)


VERTICES = ("v1", "v2", "v3")
ROOTS = [bent(0, 2.0), bent(1, 0.4, parent=0)]


@pytest.fixture
def result(ball_result: Callable[..., Path]) -> Path:
    """Return what an export reads of a result with roots."""
    folder = ball_result("result")
    write_rsml(folder / "roots.rsml", ROOTS)
    return folder


def test_tubes_are_closed_outside_out_and_have_the_roots_volume() -> None:
    mesh = root_mesh.tubes(ROOTS[:1], colour="order")
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    length = np.linalg.norm(np.diff(ROOTS[0].points_mm, axis=0), axis=1).sum()
    assert mesh.volume == pytest.approx(np.pi * length, rel=2e-3)


@pytest.mark.parametrize(("name", "unit"), [("a.ply", 1.0), ("a.stl", 1.0), ("a.obj", 1.0), ("a.glb", 1000.0)])
def test_tube_meshes_open_elsewhere(result: Path, tmp_path: Path, name: str, unit: float) -> None:
    exports.export(result, tmp_path / name, roots="diameter")
    opened = trimesh.load_mesh(tmp_path / name)
    assert opened.volume * unit**3 == pytest.approx(root_mesh.tubes(ROOTS, colour="order").volume, rel=1e-4)
    if not name.endswith("stl"):
        colours = np.unique(np.asarray(opened.visual.vertex_colors), axis=0)
        yellow = (253, 231, 37) if unit == 1.0 else (250, 204, 5)  # the last of viridis; the colours of GLB are linear
        assert tuple(colours[1, :3]) == yellow


def test_a_3mf_archive_has_the_mesh_with_colours(result: Path, tmp_path: Path) -> None:
    exports.export(result, tmp_path / "a.3mf", roots="order")
    with zipfile.ZipFile(tmp_path / "a.3mf") as archive:
        model = ET.fromstring(archive.read("3D/3dmodel.model"))
    rows = {tag: [one.attrib for one in model.iter() if one.tag.endswith(f"}}{tag}")] for tag in ("vertex", "triangle", "color")}
    vertices, faces = (
        [[float(row[key]) for key in keys] for row in rows[tag]] for tag, keys in (("vertex", "xyz"), ("triangle", VERTICES))
    )
    made = trimesh.Trimesh(vertices, np.array(faces, int), process=False)
    assert (made.volume, model.attrib["unit"]) == (pytest.approx(root_mesh.tubes(ROOTS, colour="order").volume), "millimeter")
    assert {row["color"] for row in rows["color"]} == {"#1F77B4FF", "#FF7F0EFF"}  # the first two of tab10


@pytest.mark.parametrize("name", ["a.nii.gz", "a.vtk", "a.tif"])
def test_voxels_have_sizes_and_places(tmp_path: Path, name: str) -> None:
    made = plants.make(tmp_path)
    exports.export(made.result, tmp_path / name)
    exports.export(made.result, tmp_path / "a.nrrd")
    block, about = nrrd.read(str(tmp_path / "a.nrrd"), index_order="C")
    first_mm, data = np.array(about["space origin"]), (tmp_path / name).read_bytes()
    if name == "a.tif":
        with tifffile.TiffFile(io.BytesIO(data)) as opened:
            found, sizes = opened.asarray(), opened.imagej_metadata
        stated = [*[-sizes[f"{axis}origin"] * plants.VOXEL_MM for axis in "xyz"], sizes["spacing"]]
    elif name == "a.vtk":
        lines, found = data[: -block.size].decode().splitlines(), np.frombuffer(data[-block.size :], np.uint8).reshape(block.shape)
        stated = [*map(float, lines[5].split()[1:]), float(lines[6].split()[3])]
    else:
        data = gzip.decompress(data)
        found = np.frombuffer(data[352:], np.uint8).reshape(block.shape)
        affine = np.frombuffer(data[280:328], np.float32).reshape(3, 4)
        stated = [*affine[:, 3], affine[2, 2]]
    np.testing.assert_array_equal(found, block)
    assert stated == pytest.approx([*first_mm, plants.VOXEL_MM])


def test_centre_lines_and_traits(result: Path, tmp_path: Path) -> None:
    exports.export(result, tmp_path / "Möhre_7.rsml")
    assert "<file-key>Möhre_7</file-key>" in (tmp_path / "Möhre_7.rsml").read_text(encoding="utf-8")
    np.testing.assert_array_equal(read_rsml(tmp_path / "Möhre_7.rsml")[1].points_mm, ROOTS[1].points_mm)
    exports.export(result, tmp_path / "traits.csv")
    assert "\ntips,,,,2," in (tmp_path / "traits.csv").read_text(encoding="utf-8")


def test_cameras_of_excluded_pictures_are_not_exported(tmp_path: Path) -> None:
    made = plants.make(tmp_path)
    summary = result_files.read_summary(made.result)
    summary["views"][3] |= {"used": False, "reason": "the strip or the camera moved"}
    atomic.write_json(made.result / "result.json", summary)
    exports.export(made.result, tmp_path / "cameras.json", dataset_folder=made.dataset)
    left = [frame["file_path"] for frame in json.loads((tmp_path / "cameras.json").read_text())["frames"]]
    assert left == [f"dataset/{view['file']}" for view in summary["views"] if view["used"]]
    exports.export(made.result, tmp_path / "elsewhere" / "cameras.json", dataset_folder=made.dataset)
    found = json.loads((tmp_path / "elsewhere" / "cameras.json").read_text())["frames"][0]["file_path"]
    assert (tmp_path / "elsewhere" / found).is_file()  # nerfstudio's paths are relative to the file
    atomic.write_json(made.result / "result.json", summary | {"views": [view | {"used": False} for view in summary["views"]]})
    for name in ("none.json", "none"):
        with pytest.raises(UserError, match="no calibrated picture"):
            exports.export(made.result, tmp_path / name, dataset_folder=made.dataset)


def test_names_with_spaces_are_no_names_for_colmap(tmp_path: Path) -> None:
    made = plants.make(tmp_path)
    for picture in (made.dataset / "images").iterdir():
        picture.rename(picture.with_name(f"my {picture.name}"))
    for file in (made.dataset / "dataset.json", made.result / "result.json"):
        atomic.write_text(file, file.read_text().replace("images/view", "images/my view"))
    summary = result_files.read_summary(made.result)
    atomic.write_json(made.result / "result.json", summary | {"dataset_sha256": file_sha256(made.dataset / "dataset.json")})
    with pytest.raises(UserError, match=r"COLMAP's text format allows no spaces .* images/my view_000.png"):
        exports.export(made.result, tmp_path / "colmap", dataset_folder=made.dataset)
    assert not (tmp_path / "colmap").exists()
    exports.export(made.result, tmp_path / "cameras.json", dataset_folder=made.dataset)
    exports.export(made.result, tmp_path / "undistorted", dataset_folder=made.dataset, refraction="undistorted")
    cameras = json.loads((tmp_path / "undistorted" / "transforms.json").read_text())
    assert len(cameras["frames"]) == len(list((tmp_path / "undistorted" / "images").iterdir())) == plants.VIEWS
    assert "in water" in cameras["note"]
    picture = cv2.imread(str(tmp_path / "undistorted" / "images" / "my_view_000.png"), cv2.IMREAD_UNCHANGED)
    assert picture.shape == (cameras["h"], cameras["w"])
    assert (tmp_path / "undistorted" / "colmap" / "images.txt").read_text().splitlines()[1].split()[9] == "my_view_000.png"
