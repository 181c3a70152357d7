"""The whole way from a dataset to a result: read, poses, silhouettes, shape."""

import importlib.metadata
import resource
from dataclasses import replace
from pathlib import Path

import numpy as np

from recon import drawing, markers, poses, result, shaping
from recon.cameras import View
from recon.refraction import Optics
from recon.run import Method, Run
from scenes.dataset import load_dataset, read_image
from scenes.errors import UserError

LEAST_VIEWS = 3
_VERSIONED = ("mitsuba", "drjit", "numpy", "scipy", "scikit-image", "opencv-python-headless", "trimesh")


def reconstruct(
    dataset_folder: Path, result_folder: Path, *, voxel_mm: float = 0.27, method: Method = "coverage", progress: bool = True
) -> result.Result:
    """Reconstruct a dataset and write a result folder.

    Parameters
    ----------
    voxel_mm : edge of the voxels that are written; measuring inside them is finer (`recon.shaping.FINEST_MM`).
    method : ``coverage`` measures coverage, pools all views for the poses, respects blind directions and trims the hull; ``thesis`` is
        the thesis's own way: a pose a picture, binary silhouettes, a strict AND over all views whether they see a voxel or not,
        counted leaves.

    Raises
    ------
    UserError
        Where the pictures cannot be used; the message names the file and what to do.
    """
    dataset = load_dataset(Path(dataset_folder))
    run = Run(dataset, [frame for frame in dataset.frames if frame.kind == "root"], method, progress)
    if not run.frames:
        raise UserError(f"{dataset.folder / 'dataset.json'} lists no pictures of the root; take or import some.")
    with run.stage("read"):
        run.images = run.each(lambda k: read_image(dataset, run.frames[k]), "read", list(range(len(run.frames))))
    found = _poses(run)
    views = _views(run, found)
    optics = Optics.of(dataset.scene)
    drawn = drawing.draw(run, views, optics)
    measured = shaping.build(run, drawn, views, optics, voxel_mm=voxel_mm)
    for k, silhouette in drawn.items():
        found[k] = replace(found[k], fill=float((silhouette.coverage[silhouette.seen] > 0.5).mean()))
    made = result.Result(
        dataset=str(dataset.folder),
        scene=dataset.scene.name,
        voxel_mm=voxel_mm,
        volume_mm3=measured.volume_mm3,
        volume_interval_mm3=measured.volume_interval_mm3,
        extents_min_mm=measured.extents_min_mm,
        extents_max_mm=measured.extents_max_mm,
        blind_mm3=measured.blind_mm3,
        views=tuple(found),
        warnings=tuple(run.warnings),
        timings_s=run.timings_s,
        peak_memory_mib=resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0,
        settings={"method": method, "voxel_mm": voxel_mm, "finest_mm": measured.finest_mm, "slack_px": shaping.SLACK_PX},
        versions={name: importlib.metadata.version(name) for name in _VERSIONED},
        shape=measured.shape,
        silhouettes={run.frames[k].file: silhouette for k, silhouette in drawn.items()},
    )
    result.write(made, Path(result_folder))
    return made


def _views(run: Run, found: list[result.ViewResult]) -> dict[int, View]:
    """Return the cameras of the views that can be used, by index of the frame."""
    views = {
        k: View(camera=run.dataset.scene.camera, cam_from_canister=np.array(view.cam_from_canister))
        for k, view in enumerate(found)
        if view.used
    }
    if len(views) < LEAST_VIEWS:
        reasons = "; ".join(sorted({f"{view.file}: {view.reason}" for view in found if view.reason})[:3])
        raise UserError(
            f"{run.dataset.folder}: only {len(views)} of {len(found)} pictures have a camera pose and at least {LEAST_VIEWS} are needed "
            f"({reasons})."
        )
    return views


def _poses(run: Run) -> list[result.ViewResult]:
    """Take the given cameras, or find every camera from the markers."""
    if all(frame.cam_from_canister is not None for frame in run.frames):
        return [
            result.ViewResult(
                file=frame.file,
                ring=frame.ring,
                used=True,
                cam_from_canister=[list(row) for row in frame.cam_from_canister or ()],
                table_deg=frame.table_deg,
            )
            for frame in run.frames
        ]
    strip = run.dataset.scene.strip
    with run.stage("markers"):
        detected = run.each(
            lambda k: markers.detect_markers(run.images[k], strip, measure=run.method != "thesis"), "markers", list(range(len(run.images)))
        )
    with run.stage("poses"):
        solved = poses.find_poses(detected, run.dataset.scene, run.frames, single_view=run.method == "thesis")
    found = [
        result.ViewResult(
            file=frame.file,
            ring=frame.ring,
            used=view.used,
            reason=view.reason,
            cam_from_canister=None if view.cam_from_canister is None else view.cam_from_canister.tolist(),
            reprojection_px=view.reprojection_px,
            position_sigma_mm=view.position_sigma_mm,
            rotation_sigma_deg=view.rotation_sigma_deg,
            markers=view.markers,
            table_deg=view.table_deg,
        )
        for frame, view in zip(run.frames, solved.views, strict=True)
    ]
    run.warnings += solved.warnings
    run.warnings += [f"{view.file} is left out: {view.reason}" for view in found if not view.used]
    return found
