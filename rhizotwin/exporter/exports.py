"""Export of results as meshes, voxels, roots, traits, and cameras for nerfstudio and COLMAP.

The exported cameras are the calibrated cameras in air. No lens model describes the refraction at the canister's wall
and the water, so programs that trace straight rays from these cameras reconstruct the roots incorrectly. The cameras
are valid for the rig, the marker strip and the shoot, and for programs that trace refracted rays. Each file contains a
note about this.
"""

import math
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Literal

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from rhizotwin.drawing import root_mesh, surface_mesh
from rhizotwin.exporter import mesh_files, rays, voxel_files
from rhizotwin.exporter.undistorted import VirtualCamera, best_distance_mm
from rhizotwin.recon.results import assessments
from rhizotwin.scenes import atomic, frames, rsml, trait_table
from rhizotwin.scenes.dataset import Dataset, load_dataset, read_image
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.folders import new_folder
from rhizotwin.scenes.model import Camera
from rhizotwin.scenes.monitor import Monitor
from rhizotwin.scenes.rsml_reader import read_rsml
from rhizotwin.stored import result_files, stored_traits
from rhizotwin.stored.stored_cameras import Cameras

REFRACTION = (
    "cameras in air, canister frame, mm. Refraction at the wall and in the water is not modelled, so straight rays from these cameras "
    "miss the roots"
)
IN_WATER = (
    "pinhole cameras in water, canister frame, mm. Exact on the vertical plane through the canister's axis; "
    "undistorted.json has the residuals elsewhere"
)
Posed = Sequence[tuple[str, NDArray[np.float64]]]
"""File name of each picture, and its pose cam_from_canister (4, 4) in mm."""
_SAME_PLACE_MM = 5.0
"""Interval by which the distances and heights of cameras are rounded, in mm. The pinhole distance is computed once for
all cameras that have the same rounded distance and height."""
Refraction = Literal["undistorted", "rays"]
"""Treatment of refraction: pictures with refraction removed, and the pinhole cameras in water that correspond to them,
or the line of sight in the water of each pixel, and the cameras in air."""
MOST_POINTS = 50_000
"""Maximum number of points of the surface that are written to a COLMAP model. Splatting starts with a Gaussian at each
point, and structure from motion of a whole scene finds 10,000 to 200,000 points."""


def export(
    result_folder: Path,
    output: Path,
    *,
    dataset_folder: Path | None = None,
    roots: str | None = None,
    refraction: Refraction | None = None,
    monitor: Monitor | None = None,
) -> list[Path]:
    """Write a result in the file format that the suffix of the output selects.

    Parameters
    ----------
    result_folder : path
        Folder of the result.
    output : path
        File, whose suffix selects the format, or folder, see `rhizotwin.api.outputs.export`.
    dataset_folder : path or None
        Folder of the dataset; required for the export of cameras.
    roots : {"order", "diameter"} or None
        Mesh formats only: write the roots as tubes, coloured by this property, instead of the surface.
    refraction : Refraction or None
        What a folder receives instead of the cameras in air.
    monitor : Monitor or None
        Receiver of the progress of ``refraction``.

    Returns
    -------
    list of Path
        Written files.
    """
    suffix = suffix_of(output)
    writers: dict[str, Callable[[Path, Path], list[Path]]] = {
        **dict.fromkeys(mesh_files.SUFFIXES, _mesh if roots is None else lambda folder, file: _tubes(folder, file, roots)),
        **dict.fromkeys(voxel_files.ENCODERS, _voxels),
        ".rsml": _rsml,
        ".csv": _traits,
    }
    if suffix not in (*writers, ".json", ""):
        known = ", ".join(writers)
        raise UserError(f"{output}: the format {suffix} is unknown; use {known}, .json (nerfstudio cameras) or a folder (COLMAP cameras)")
    if roots is not None and suffix not in mesh_files.SUFFIXES:
        raise UserError(f"{output}: --roots applies to meshes only; use {', '.join(mesh_files.SUFFIXES)}, or remove --roots")
    if refraction and suffix:
        raise UserError(f"{output}: --{refraction} writes a folder; give a name without a suffix")
    if output.exists() and (suffix or not output.is_dir()):  # `new_folder` checks and recovers folders
        raise UserError(f"{output} already exists; choose another name")
    summary = result_files.read_summary(result_folder)
    if suffix in writers:
        return writers[suffix](result_folder, output)
    if dataset_folder is None:
        raise UserError(f"{output}: the export of cameras needs the lens, which is stored in the dataset; add --dataset DATASET")
    dataset = load_dataset(dataset_folder)
    result_files.check_same_scan(summary["dataset_sha256"], summary["scene"], result_folder, dataset)
    cameras = Cameras.of(dataset, summary)
    if not cameras.views:
        raise UserError(f"{output}: the result contains no calibrated picture, so there are no cameras to export; choose another result")
    if refraction == "undistorted":
        return _undistorted(output, dataset, cameras, result_folder, monitor or Monitor())
    return _rays(output, dataset, cameras, monitor or Monitor()) if refraction else _cameras(output, dataset, cameras)


def choose(*, undistorted: bool, rays: bool) -> Refraction | None:
    """Return the treatment of refraction that one of two options selects; None if there is none."""
    if undistorted and rays:
        raise UserError("undistorted pictures and rays are different folders; export one after the other")
    return "undistorted" if undistorted else "rays" if rays else None


def suffix_of(output: Path) -> str:
    """Return the suffix of a file in lower case, ``.nii.gz`` for compressed NIfTI files."""
    return ".nii.gz" if output.name.lower().endswith(".nii.gz") else output.suffix.lower()


def _mesh(result_folder: Path, output: Path) -> list[Path]:
    """Write the closed surface of the shape as a mesh.

    Small components that are not connected to the shape are omitted.
    """
    mesh = surface_mesh.close(result_files.read_mesh(result_folder / "shape.ply"))
    return _write_mesh(trimesh.Trimesh(mesh.vertices_mm, mesh.faces, process=False), output)


def _tubes(result_folder: Path, output: Path, colour: str) -> list[Path]:
    """Write the roots as a mesh of coloured tubes."""
    return _write_mesh(root_mesh.tubes(read_rsml(_roots_of(result_folder)), colour=colour), output)


def _write_mesh(solid: trimesh.Trimesh, output: Path) -> list[Path]:
    atomic.write_bytes(output, mesh_files.encode(solid, suffix_of(output)))
    return [output]


def _rsml(result_folder: Path, output: Path) -> list[Path]:
    """Write the centre lines of the roots as RSML.

    The name of the file becomes the key of the root system.
    """
    rsml.write_rsml(output, read_rsml(_roots_of(result_folder)))
    return [output]


def _traits(result_folder: Path, output: Path) -> list[Path]:
    summary, traits = result_files.read_summary(result_folder), stored_traits.read(result_folder)
    atomic.write_text(output, trait_table.to_csv(traits, assessments.assess(summary, traits)))
    return [output]


def _roots_of(result_folder: Path) -> Path:
    file = result_folder / "roots.rsml"
    if not file.is_file():
        raise UserError(
            f"the result {result_folder} has no centre lines, because no thin roots were found; export its traits (.csv) instead"
        )
    return file


def _voxels(result_folder: Path, output: Path) -> list[Path]:
    """Write the occupancy of all voxels in the bounding box as bytes (0 to 255)."""
    leaves = result_files.read_leaves(result_folder)
    shape = voxel_files.bounding_shape(leaves)
    if math.prod(shape) > voxel_files.MOST_VOXELS:
        size = "x".join(str(n) for n in shape)
        raise UserError(f"{output}: a dense block of {size} voxels is too large; reconstruct with larger voxels (--voxel-mm)")
    atomic.write_bytes(output, voxel_files.ENCODERS[suffix_of(output)](voxel_files.block_of(leaves)))
    return [output]


def _cameras(output: Path, dataset: Dataset, cameras: Cameras) -> list[Path]:
    """Write the calibrated cameras in air for nerfstudio (.json) or COLMAP (folder).

    The paths of the pictures are relative to the file for nerfstudio, and to the dataset for COLMAP.
    """
    poses = [view.cam_from_canister for view in cameras.views]
    lens = cameras.views[0].camera
    if not output.suffix:
        return write_colmap(output, lens, list(zip(cameras.files, poses, strict=True)))
    files = [_relative(dataset.folder / file, output.parent) for file in cameras.files]
    return write_nerfstudio(output, lens, list(zip(files, poses, strict=True)))


def _relative(file: Path, folder: Path) -> str:
    """Return the path of a file from a folder, with forward slashes; on another drive (Windows), its absolute path."""
    try:
        return Path(os.path.relpath(file, folder)).as_posix()
    except ValueError:
        return file.absolute().as_posix()


def write_nerfstudio(output: Path, camera: Camera, posed: Posed, *, note: str = REFRACTION) -> list[Path]:
    """Write cameras to a file transforms.json in nerfstudio's format.

    Translations are in mm.

    Parameters
    ----------
    output : path
        Output file.
    camera : Camera
        Lens of all pictures.
    posed : sequence of (str, (4, 4) array)
        File name and pose cam_from_canister of each picture.
    note : str
        Text of the key ``note``.

    Returns
    -------
    list of Path
        Written file.
    """
    k1, k2, p1, p2, k3 = camera.distortion
    lens = {
        "camera_model": "OPENCV",
        "w": camera.image_wh[0],
        "h": camera.image_wh[1],
        "fl_x": camera.focal_px[0],
        "fl_y": camera.focal_px[1],
        "cx": camera.principal_px[0] + 0.5,  # the origin is the corner of the first pixel
        "cy": camera.principal_px[1] + 0.5,
        "k1": k1,
        "k2": k2,
        "k3": k3,
        "p1": p1,
        "p2": p2,
    }
    listed = [
        {"file_path": file, "transform_matrix": (frames.invert(cam_from_canister) @ frames.OPENCV_FROM_OPENGL).tolist()}
        for file, cam_from_canister in posed
    ]
    atomic.write_json(output, {"note": note, **lens, "frames": listed})
    return [output]


def write_colmap(
    output: Path, camera: Camera, posed: Posed, *, note: str = REFRACTION, points_mm: NDArray[np.float64] | None = None
) -> list[Path]:
    """Write cameras as a COLMAP text model.

    The lens model is the simplest that holds the distortion, because programs for splatting read only PINHOLE, and
    nerfstudio's reader of COLMAP models refuses FULL_OPENCV. Pixel centres are at half-integers. Poses are quaternions
    (w, x, y, z) and translations of cam_from_canister, mm.

    Parameters
    ----------
    output : path
        Output folder.
    camera, posed, note : Camera, sequence, str
        See `write_nerfstudio`.
    points_mm : (N, 3) array or None
        Points of the surface in the canister frame, mm, of which at most `MOST_POINTS` are written, in grey and without
        observations. None for no points.

    Returns
    -------
    list of Path
        Written files.

    Raises
    ------
    UserError
        If the name of a picture contains a space, at which COLMAP ends the name.
    """
    for file, _ in posed:
        if " " in file:
            raise UserError(
                f"{output}: COLMAP's text format allows no spaces in the names of pictures, such as {file}; export a .json file, or "
                "rename the pictures, import them and repeat the reconstruction"
            )
    k1, k2, p1, p2, k3 = camera.distortion
    (fx, fy), (cx, cy) = camera.focal_px, camera.principal_px
    bent = () if not any(camera.distortion) else (k1, k2, p1, p2) if k3 == 0.0 else (k1, k2, p1, p2, k3, 0.0, 0.0, 0.0)
    model = {0: "PINHOLE", 4: "OPENCV", 8: "FULL_OPENCV"}[len(bent)]
    numbers = " ".join(f"{number:.17g}" for number in (fx, fy, cx + 0.5, cy + 0.5, *bent))
    lens = f"1 {model} {camera.image_wh[0]} {camera.image_wh[1]} {numbers}"
    shown = np.empty((0, 3)) if points_mm is None else points_mm[:: len(points_mm) // MOST_POINTS + 1]
    points = [f"{number} {x:.6g} {y:.6g} {z:.6g} 128 128 128 0" for number, (x, y, z) in enumerate(shown, start=1)]
    lines = []
    for number, (file, cam_from_canister) in enumerate(posed, start=1):
        x, y, z, w = Rotation.from_matrix(cam_from_canister[:3, :3]).as_quat()
        pose = " ".join(f"{value:.17g}" for value in (w, x, y, z, *cam_from_canister[:3, 3]))
        lines += [f"{number} {pose} 1 {file}", ""]
    written = {"cameras.txt": [lens], "images.txt": lines, "points3D.txt": points}
    with new_folder(output) as building:
        for name, rows in written.items():
            atomic.write_text(building / name, "\n".join([f"# {note}", *rows]) + "\n")
    return [output / name for name in written]


def _undistorted(output: Path, dataset: Dataset, cameras: Cameras, result_folder: Path, monitor: Monitor) -> list[Path]:
    """Write pictures with refraction removed, and their pinhole cameras for nerfstudio and COLMAP.

    The COLMAP model contains points of the surface, because programs for splatting do not start without points.
    """
    points_mm = result_files.read_mesh(result_folder / "shape.ply").vertices_mm
    scene = dataset.scene
    if scene.tank is not None:
        raise UserError(
            f"{output}: pictures of a canister in a tank cannot be undistorted, because a pinhole camera cannot approximate "
            "the refraction at a flat wall"
        )
    heights_mm = scene.canister.floor_z_mm, min(scene.water.level_mm, scene.net_pot.grid_z_mm)
    known = {frame.file: frame for frame in dataset.frames}
    places: dict[tuple[int, int], tuple[float, float]] = {}
    lens: Camera | None = None  # lens of the first picture, because both formats have one lens for all pictures
    names = {file: f"{Path(file).stem.replace(' ', '_')}.png" for file in cameras.files}  # COLMAP allows no spaces
    if len(set(names.values())) < len(names):
        raise UserError(f"{output}: the names of two pictures differ only in spaces and underscores; rename one of them, and import again")
    posed = list[tuple[str, NDArray[np.float64]]]()
    with new_folder(output) as building, monitor.stage("pictures"), monitor.steps("pictures", len(cameras.views), "picture") as step:
        (building / "images").mkdir()
        for file, view in zip(cameras.files, cameras.views, strict=True):
            place = round(float(np.hypot(*view.centre_mm[:2])) / _SAME_PLACE_MM), round(float(view.centre_mm[2]) / _SAME_PLACE_MM)
            if place not in places:
                places[place] = best_distance_mm(view, cameras.optics, heights_mm)
            camera = VirtualCamera(view, cameras.optics, places[place][0], heights_mm, None if lens is None else lens.focal_px[0])
            lens = camera.lens
            name = names[file]
            atomic.write_image(building / "images" / name, camera.undistort(np.asarray(read_image(dataset, known[file]))))
            posed.append((name, camera.cam_from_canister))
            step()
        assert lens is not None
        write_nerfstudio(building / "transforms.json", lens, [(f"images/{name}", pose) for name, pose in posed], note=IN_WATER)
        write_colmap(building / "colmap", lens, posed, note=IN_WATER, points_mm=points_mm)
        about = [{"pinhole_distance_mm": distance_mm, "off_plane_rms_px": left_px} for distance_mm, left_px in places.values()]
        atomic.write_json(building / "undistorted.json", {"exact_on": "the vertical plane through the axis", "camera_places": about})
    return [output / "images", output / "transforms.json", output / "colmap", output / "undistorted.json"]


def _rays(output: Path, dataset: Dataset, cameras: Cameras, monitor: Monitor) -> list[Path]:
    """Write the line of sight in the water of each pixel, the program that reads them, and the cameras in air."""
    if cameras.optics.straight:
        raise UserError(
            f"{output}: the rays of this scan are straight, so that cameras describe them; export a .json file or a COLMAP folder"
        )
    stems = [Path(file).stem for file in cameras.files]
    lens = cameras.views[0].camera
    if len(set(stems)) < len(stems):
        raise UserError(f"{output}: two pictures differ only in their folder or suffix; rename one of them, and import again")
    posed = [(file, view.cam_from_canister) for file, view in zip(cameras.files, cameras.views, strict=True)]
    with new_folder(output) as building, monitor.stage("pictures"), monitor.steps("pictures", len(stems), "picture") as step:
        (building / "rays").mkdir()
        for stem, view in zip(stems, cameras.views, strict=True):
            rays.trace(view, cameras.optics, dataset.scene).write(building / "rays" / f"{stem}.npz")
            step()
        listed = [{"file": file, "rays": f"rays/{stem}.npz"} for file, stem in zip(cameras.files, stems, strict=True)]
        atomic.write_json(building / "rays.json", {"note": rays.NOTE, "image_wh": lens.image_wh, "pictures": listed})
        atomic.write_text(building / "load_rays.py", rays.LOADER)
        write_nerfstudio(building / "transforms.json", lens, posed)
        write_colmap(building / "colmap", lens, posed)
    return [output / name for name in ("rays", "rays.json", "load_rays.py", "transforms.json", "colmap")]


def describe(written: list[Path]) -> str:
    """Return a sentence that lists the written files.

    If they contain cameras, the sentence warns that these do not model refraction.
    """
    warning = f" ({REFRACTION})" if written[0].suffix in (".json", ".txt") else ""
    return f"wrote {', '.join(str(path) for path in written)}{warning}"
