"""Cameras of the imported pictures, from a file in nerfstudio's format."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from rhizotwin.nerfstudio import GivenCameras, read_cameras
from rhizotwin.scenes import files, frames
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Scene


def pose_of(path: Path, given: GivenCameras) -> frames.Array | None:
    """Return the pose cam_from_canister (4, 4) of a picture from the camera file.

    The file name of the picture may be written without its suffix in the camera file. The result is None if the camera
    file does not contain the picture.
    """
    return given.cam_from_canister.get(path.name, given.cam_from_canister.get(path.stem))


def read_camera_file(scene: Scene, cameras: Path) -> tuple[Scene, GivenCameras]:
    """Read a camera file.

    Parameters
    ----------
    scene : Scene
        Scene with the canister, and with the properties of the camera that the format does not include.
    cameras : Path
        File in nerfstudio's format (see `rhizotwin.nerfstudio`).

    Returns
    -------
    Scene, GivenCameras
        Copy of the scene with the lens of the file, and the cameras in the canister frame, mm.

    Raises
    ------
    UserError
        If the file is unreadable or invalid, or a camera is inside the canister.
    """
    given = read_cameras(cameras, scene.camera)
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
    kept = [path for path in paths if pose_of(path, given) is not None]
    names = {path.name for path in paths} | {path.stem for path in paths}
    missing = [name for name in given.cam_from_canister if name not in names]
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


def _check_cameras(given: GivenCameras, scene: Scene, cameras: Path) -> None:
    """Raise UserError if a camera is inside the canister, which indicates a wrong unit or coordinate frame."""
    for name, cam_from_canister in given.cam_from_canister.items():
        centre_mm = frames.invert(cam_from_canister)[:3, 3]
        inside = np.hypot(centre_mm[0], centre_mm[1]) < scene.canister.outer_radius_mm
        if inside and scene.water.n_water > 1.0 and -scene.canister.height_mm < centre_mm[2] < 0.0:
            x, y, z = centre_mm
            raise UserError(
                f"{cameras}: the camera of {name} is inside the canister, at ({x:.3g}, {y:.3g}, {z:.3g}) mm; "
                "coordinates must be given in the canister frame in millimetres"
            )
