"""Exact silhouettes of round-ended tubes, drawn with the reference projection."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy import ndimage

from rhizotwin.recon.calibration.cameras import Camera as FoundCamera
from rhizotwin.recon.calibration.cameras import Cameras, RigUncertainty
from rhizotwin.recon.coverage.silhouettes import Silhouette
from rhizotwin.recon.optics import cameras, refraction
from rhizotwin.scenes import atomic, plan
from rhizotwin.scenes.dataset import Dataset, Frame, file_sha256, save_dataset
from rhizotwin.scenes.model import Camera, CapturePlan, Ring, Scene

Segment = tuple[tuple[float, float, float], tuple[float, float, float], float]
"""Ends and radius of a tube, mm."""
_PIXEL_MM = 1.0
"""More than a pixel's diagonal in the water, at 240 columns and more."""


def ring_of(views: int, image_wh: tuple[int, int] = (400, 300), **ring: float) -> Scene:
    return Scene(camera=Camera().resized(image_wh), plan=CapturePlan(rings=(Ring(views=views, **ring),)))


def cameras_of(views: Sequence[cameras.View], optics: refraction.Optics, uncertainty: RigUncertainty | None = None) -> Cameras:
    """Return the cameras of views that share one lens."""
    every = tuple(
        FoundCamera(file="", ring=0, used=True, cam_from_canister=view.cam_from_canister, cam_from_tank=view.cam_from_tank)
        for view in views
    )
    return Cameras(lens=views[0].camera, optics=optics, all=every, order=tuple(range(len(views))), uncertainty=uncertainty)


def views_of(scene: Scene) -> list[cameras.View]:
    """Return the views of a scene's plan, without any error."""
    return [
        cameras.View(camera=scene.camera, cam_from_canister=v.cam_from_rig @ plan.rig_from_table(scene, v.table_deg))
        for v in plan.views(scene)
    ]


def rows(matrix: np.ndarray) -> tuple[tuple[float, ...], ...]:
    """Return a matrix as files and plans hold it."""
    return tuple(tuple(float(value) for value in row) for row in matrix)


def masks(folder: Path, scene: Scene, pictures: dict[int, np.ndarray], **origin: object) -> Dataset:
    """Write silhouettes (H, W) of some views with their exact cameras, as a dataset."""
    listed, every = [], views_of(scene)
    for k, picture in pictures.items():
        atomic.write_image(folder / f"{k}.png", np.round(255.0 * picture).astype(np.uint8))
        listed.append(Frame(file=f"{k}.png", sha256=file_sha256(folder / f"{k}.png"), cam_from_canister=rows(every[k].cam_from_canister)))
    dataset = Dataset(folder=folder, scene=scene, frames=tuple(listed), masks=True, origin=origin)
    save_dataset(dataset)
    return dataset


def drawn(view: cameras.View, optics: refraction.Optics, segments: tuple[Segment, ...], samples: int = 3) -> Silhouette:
    """Draw a view: the share of each pixel's lines of sight that meet a tube, by samples where an outline or the water's edge passes."""
    width, height = view.camera.image_wh
    v, u = (axis.ravel() for axis in np.mgrid[:height, :width])
    depth, enters = (part.reshape(height, width) for part in _depth_mm(view, optics, np.stack([u, v], axis=1), segments))
    covered, seen = (depth > 0) & enters, ndimage.minimum_filter(enters, 3)
    coverage = covered.astype(np.float32)
    torn = ((np.abs(depth) < _PIXEL_MM) | ~seen) & ndimage.maximum_filter(enters, 3)
    share = (np.arange(samples) + 0.5) / samples - 0.5
    dv, du = (axis.ravel() for axis in np.meshgrid(share, share))
    at = np.stack([u[torn.ravel(), None] + du, v[torn.ravel(), None] + dv], axis=-1).reshape(-1, 2)
    depth, enters = (part.reshape(-1, samples**2) for part in _depth_mm(view, optics, at, segments))
    coverage[torn], seen[torn] = ((depth > 0) & enters).mean(axis=1), enters.all(axis=1)
    return Silhouette(coverage, seen)


def _depth_mm(
    view: cameras.View, optics: refraction.Optics, px: np.ndarray, segments: tuple[Segment, ...]
) -> tuple[np.ndarray, np.ndarray]:
    """Return how deep lines of sight of pixels (N, 2) pass inside tubes, negative outside, and whether they enter the water."""
    line, enters = cameras.water_lines(view, optics, px.astype(np.float64))
    direction = np.concatenate([line.t, line.slope[:, None]], axis=1)
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    foot_z = line.entry_z_mm + line.slope * np.sqrt(optics.inner_radius_mm**2 - line.b_mm**2)
    back = view.azimuth_from_canister[:3, :3]
    origin, direction = np.concatenate([line.nu * line.b_mm[:, None], foot_z[:, None]], axis=1) @ back, direction @ back
    return np.max([segment[2] - distance_to_line(segment, origin, direction) for segment in segments], axis=0), enters


def distance_to_line(segment: Segment, origin: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Return the distance of lines (N) to a segment, by the closed form for two lines with the segment's end points clamped."""
    a, b, _ = (np.array(part) for part in segment)
    axis = b - a
    w = origin - a
    d_u, d_w, u_u, u_w = direction @ axis, np.sum(direction * w, 1), axis @ axis, w @ axis
    t = np.clip((u_w - d_u * d_w) / np.maximum(u_u - d_u**2, 1e-12), 0.0, 1.0)
    offset = w - t[:, None] * axis
    return np.linalg.norm(offset - np.sum(offset * direction, 1, keepdims=True) * direction, axis=1)
