"""Creation of an input folder for other methods: a benchmark scan in open formats, without its ground truth.

The folder contains these files:

- ``dataset.json``, ``images/``: dataset as written by ``rhizotwin simulate``, without the folder ``truth``
- ``transforms.json``: cameras of the original pictures in nerfstudio's format, with lens distortion
- ``colmap/``: same cameras in COLMAP's text format
- ``masks/``: binary silhouettes, segmented from the pictures, in which root pixels are 255
- ``undistorted/``: pictures and masks with lens distortion removed, and their ``transforms.json``

All cameras are in the canister frame, mm. The pictures show the roots refracted by a round wall and water, so straight
rays from these cameras miss the roots.
"""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from rhizotwin.exporter.exports import Posed, write_colmap, write_nerfstudio
from rhizotwin.scenes import atomic
from rhizotwin.scenes.dataset import Dataset, load_dataset, read_image
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Camera
from rhizotwin.scenes.monitor import Monitor
from rhizotwin.scenes.truth import load_truth

Picture = NDArray[np.uint8 | np.uint16]
CameraSource = Literal["estimated", "true"]
_HALF = 0.5
"""Minimum coverage of a pixel by roots. Pixels of at least this coverage are root pixels in the mask."""


def offer(dataset_folder: Path, goal: Path, *, cameras: CameraSource) -> None:
    """Write the input folder for other methods.

    The docstring of this module lists the files in the folder.

    Parameters
    ----------
    dataset_folder : path
        Simulated dataset, whose ground truth is not copied.
    goal : path
        New folder.
    cameras : {"estimated", "true"}
        Cameras to write: estimated from the markers, or true (poses and focal length). The masks are always based on
        the estimated cameras.

    Raises
    ------
    UserError
        If no camera can be estimated from the pictures.
    """
    from rhizotwin.recon.calibration.curve import verify_curve
    from rhizotwin.recon.calibration.find_cameras import find_cameras
    from rhizotwin.recon.coverage.measure import measure_coverage
    from rhizotwin.recon.read_pictures import read_pictures

    dataset = load_dataset(dataset_folder)
    shutil.copytree(dataset_folder, goal, ignore=shutil.ignore_patterns("truth", ".*"))
    monitor = Monitor()
    pictures = verify_curve(read_pictures(dataset, monitor=monitor), monitor=monitor)
    found = find_cameras(pictures, monitor=monitor)
    found, coverage = measure_coverage(pictures, found, monitor=monitor)
    files = [frame.file for frame in pictures.frames]
    used = sorted(found.order)
    masks: dict[str, Picture] = {files[k]: np.where(coverage.silhouettes[k].coverage >= _HALF, 255, 0).astype(np.uint8) for k in used}
    if cameras == "true":
        truth = load_truth(dataset_folder)
        posed: Posed = [(view.file, np.asarray(view.cam_from_canister)) for view in truth.views]
        lens = dataset.scene.camera.focused(1.0 + float(truth.drawn.get("focal_error", 0.0))).as_pinhole()
    else:
        posed = [(files[k], np.asarray(found.all[k].cam_from_canister)) for k in used]
        lens = found.lens.as_pinhole()
    if not posed:
        raise UserError(f"{dataset_folder}: no camera pose could be estimated from the pictures; use the true cameras with --cameras true")
    write_nerfstudio(goal / "transforms.json", lens, posed)
    write_colmap(goal / "colmap", lens, posed)
    for file, mask in masks.items():
        _write(goal / "masks" / f"{Path(file).stem}.png", mask)
    _undistort(dataset, lens, posed, masks, goal / "undistorted")


def _undistort(dataset: Dataset, lens: Camera, posed: Posed, masks: dict[str, Picture], goal: Path) -> None:
    """Remove the lens distortion from pictures and masks, and write them together with their cameras."""
    (fx, fy), (cx, cy) = lens.focal_px, lens.principal_px
    matrix = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    distortion = np.array(lens.distortion)
    known = {frame.file: frame for frame in dataset.frames}
    frames = []
    for file, pose in posed:
        picture = np.asarray(read_image(dataset, known[file]))
        name = f"{Path(file).stem}.png"
        _write(goal / "images" / name, cv2.undistort(picture, matrix, distortion))
        if file in masks:
            _write(goal / "masks" / name, np.where(cv2.undistort(masks[file], matrix, distortion) >= 128, 255, 0).astype(np.uint8))
        frames.append((f"images/{name}", pose))
    write_nerfstudio(goal / "transforms.json", replace(lens, distortion=(0.0, 0.0, 0.0, 0.0, 0.0)), frames)


def _write(path: Path, picture: Picture) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    atomic.write_image(path, picture)
