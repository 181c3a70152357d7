"""Cameras of the imported pictures, from a file in nerfstudio's format or from a COLMAP model."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from rhizotwin.importer.colmap_model import read_colmap
from rhizotwin.importer.given_cameras import GivenCameras
from rhizotwin.importer.given_lens import Lens
from rhizotwin.importer.nerfstudio_file import read_cameras
from rhizotwin.scenes import files, frames
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import FAR_MM, Scene


def read_camera_file(scene: Scene, cameras: Path) -> tuple[Scene, GivenCameras]:
    """Read a camera file or a COLMAP model.

    Parameters
    ----------
    scene : Scene
        Scene with the canister, and with the properties of the camera that the format does not include.
    cameras : Path
        File in nerfstudio's format (see `rhizotwin.importer.nerfstudio_file`), or folder of a COLMAP model (see
        `rhizotwin.importer.colmap_model`).

    Returns
    -------
    Scene, GivenCameras
        Copy of the scene with the lens of the file, and the cameras in the canister frame, mm.

    Raises
    ------
    UserError
        If the file is unreadable or invalid, or a camera is inside the canister or does not show it.
    """
    read = read_colmap if cameras.is_dir() else read_cameras
    given = read(cameras, scene.camera)
    changed = replace(scene, camera=given.camera)
    scene = files.scene_from_dict(files.scene_to_dict(changed), where=f"scene {scene.name} with the lens of {cameras}")
    _check_cameras(given, scene, cameras)
    return scene, given


def with_cameras(paths: list[Path], given: GivenCameras, cameras: Path, notes: list[str]) -> list[Path]:
    """Return the pictures for which a camera is given.

    Parameters
    ----------
    paths : list of Path
        Pictures of the folder.
    given : GivenCameras
        Cameras of the file.
    cameras : Path
        Camera file, for messages.
    notes : list of str
        Notes for the user. If there are pictures without a camera, a note about them is added.

    Returns
    -------
    list of Path
        Pictures with a camera, in their order.

    Raises
    ------
    UserError
        If the picture of a camera is missing.
    """
    kept = [path for path in paths if given.of(path) is not None]
    names = {path.name for path in paths} | {path.stem for path in paths}
    missing = [name for name in given.pictures if name not in names]
    if missing:
        more = f" and {len(missing) - 1} more" if len(missing) > 1 else ""
        raise UserError(
            f"{cameras} has a camera for {missing[0]}{more}, but this picture is missing in {paths[0].parent}; "
            "add the picture or remove the camera"
        )
    without = [path.name for path in paths if path not in kept]
    if without:
        notes.append(f"pictures that were not imported, because {cameras} has no camera for them: {', '.join(without)}")
    return kept


def lens_notes(given: GivenCameras) -> list[str]:
    """Return notes about values of the camera file that were assumed or ignored, and about replaced lenses."""
    lenses, camera = given.lenses, given.camera
    kinds = "a fisheye lens" if any(lens.is_fisheye for lens in lenses) else "a lens with k4, k5 or k6"
    if len(lenses) > 1:
        kinds = f"{len(lenses)} different lenses"
    if given.is_resampled:
        model = "the lens of most pictures" if any(camera.distortion) else "one lens without distortion"
        said = [
            f"the pictures have {kinds}, which one camera of this program cannot describe. They were resampled to {model} with "
            f"{camera.image_wh[0]}x{camera.image_wh[1]} px, without the margins that only some of them show, or that are more than 65 "
            "degrees from the optical axis"
        ]
    elif all(lens == Lens.of(camera) for lens in lenses):
        said = []
    else:
        terms = ", ".join(f"{value:.6g}" for value in camera.distortion)
        off_px = max(lens.difference_px(camera) for lens in lenses)
        said = [f"{kinds} replaced by OpenCV's ordinary model with k1, k2, p1, p2, k3 = {terms}; it differs by at most {off_px:.2g} px"]
    return [*given.notes, *said]


def _check_cameras(given: GivenCameras, scene: Scene, cameras: Path) -> None:
    """Raise UserError if a camera cannot belong to the scene, which indicates a wrong unit, frame or projection."""
    must = "coordinates must be given in the canister frame in millimetres"
    radius_mm, height_mm = scene.canister.outer_radius_mm, scene.canister.height_mm
    corners = np.array(
        [[x, y, z] for x in (-radius_mm, 0.0, radius_mm) for y in (-radius_mm, 0.0, radius_mm) for z in np.linspace(-height_mm, 0.0, 9)]
    )
    for name, picture in given.pictures.items():
        centre_mm = frames.invert(picture.cam_from_canister)[:3, 3]
        x, y, z = centre_mm
        inside = np.hypot(x, y) < radius_mm
        if inside and scene.water.n_water > 1.0 and -height_mm < z < 0.0:
            raise UserError(f"{cameras}: the camera of {name} is inside the canister, at ({x:.3g}, {y:.3g}, {z:.3g}) mm; {must}")
        if scene.camera.kind == "telecentric" and np.linalg.norm(centre_mm) < 0.5 * FAR_MM:
            raise UserError(
                f"{cameras}: the camera of {name} is a perspective camera, but that of the scene is telecentric; set camera.kind of "
                'the scene to "pinhole"'
            )
        in_cam = frames.apply(picture.cam_from_canister, corners)
        px = Lens.of(given.camera).pixels(in_cam[in_cam[:, 2] > 0.0, :2] / in_cam[in_cam[:, 2] > 0.0, 2:])
        if not ((px > 0.0) & (px < np.array(given.camera.image_wh))).all(axis=1).any():
            raise UserError(
                f"{cameras}: the camera of {name}, at ({x:.3g}, {y:.3g}, {z:.3g}) mm, does not show the canister; {must}, and rotations "
                "with the axes of the format"
            )
