"""Check that COLMAP, and programs for splatting, open exported cameras; pycolmap is not installed in CI."""

import json
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pycolmap

POINTS_MM = [(x, y, z, 1.0) for x in (-20.0, 0.0, 20.0) for y in (-20.0, 15.0) for z in (-90.0, -40.0)]
SPLATTING = ("PINHOLE", "SIMPLE_PINHOLE")
"""Lens models of gaussian-splatting (scene/dataset_readers.py, readColmapCameras) and of programs derived from it."""
NERFSTUDIO = (*SPLATTING, "SIMPLE_RADIAL", "RADIAL", "OPENCV", "OPENCV_FISHEYE", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE")
"""Lens models of nerfstudio 1.1.5 (data/dataparsers/colmap_dataparser.py, parse_colmap_camera_params)."""


def check_colmap_model(model: Path, transforms: Path, *, undistorted: bool = False) -> dict[str, tuple[float, float]]:
    """Compare an exported COLMAP model, as pycolmap reads it, with the same cameras in a file transforms.json.

    The result contains each number by pycolmap and ours. An AssertionError is raised if they differ by more than 0.1 %,
    or if a program would refuse the lens, or an undistorted model for its lack of points.
    """
    given = json.loads(transforms.read_text(encoding="utf-8"))
    read = pycolmap.Reconstruction(str(model))
    numbers = _numbers(read, given)
    with TemporaryDirectory() as folder:  # COLMAP's own binary files hold the same
        read.write_binary(folder)
        numbers |= {f"{name}, binary": values for name, values in _numbers(pycolmap.Reconstruction(folder), given).items()}
    wrong = {name: values for name, values in numbers.items() if abs(values[0] - values[1]) > 1e-3 * abs(values[1])}
    assert not wrong, f"{model}: {wrong}"
    lens, bent = next(iter(read.cameras.values())).model.name, any(given[key] for key in ("k1", "k2", "p1", "p2"))
    assert lens in ("FULL_OPENCV",) if given["k3"] else lens in (NERFSTUDIO if bent else SPLATTING), lens
    assert not undistorted or (lens in SPLATTING and read.num_points3D() > 0), f"{model}: {lens}, {read.num_points3D()} points"
    return numbers


def _numbers(read: Any, given: dict[str, Any]) -> dict[str, tuple[float, float]]:
    """Return numbers by pycolmap, and the same by the conventions of transforms.json."""
    images = {Path(image.name).name: image for image in read.images.values()}
    camera, (k1, k2, k3, p1, p2) = next(iter(read.cameras.values())), (given[key] for key in ("k1", "k2", "k3", "p1", "p2"))
    numbers = {"pictures": (len(images), len(given["frames"])), "width": (camera.width, given["w"]), "height": (camera.height, given["h"])}
    for frame in given["frames"]:
        for index, point in enumerate(POINTS_MM):
            x, y, z = (np.linalg.inv(np.array(frame["transform_matrix"])) @ point)[:3] * [1.0, -1.0, -1.0]
            u, v = x / z, y / z
            r2 = u * u + v * v
            radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
            ours = [
                given["fl_x"] * (u * radial + 2.0 * p1 * u * v + p2 * (r2 + 2.0 * u * u)) + given["cx"],
                given["fl_y"] * (v * radial + p1 * (r2 + 2.0 * v * v) + 2.0 * p2 * u * v) + given["cy"],
            ]
            name = Path(frame["file_path"]).name
            numbers |= {
                f"{name}, {index}, {k}": pair for k, pair in enumerate(zip(images[name].project_point(point[:3]), ours, strict=True))
            }
    return numbers
