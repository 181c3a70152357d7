"""Comparison of a result with pictures that were not used in its reconstruction."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from skimage.morphology import skeletonize

from rhizotwin.recon.calibration.cameras import Camera, Cameras
from rhizotwin.recon.calibration.curve import verify_curve
from rhizotwin.recon.calibration.find_cameras import find_cameras
from rhizotwin.recon.coverage.measure import measure_coverage
from rhizotwin.recon.coverage.silhouettes import UNSEEN_PX, UPSAMPLING, Image, Mask, Silhouette, signed_distance
from rhizotwin.recon.read_pictures import picture_hash, read_pictures
from rhizotwin.recon.results.parts import Json
from rhizotwin.recon.results.result import Result
from rhizotwin.scenes import frames
from rhizotwin.scenes.dataset import Dataset, load_dataset
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.monitor import Monitor
from rhizotwin.scoring import drawn
from rhizotwin.scoring.score_solid import table_of
from rhizotwin.stored.load import load_result

NEAR_PX = 2.0
"""Maximum distance at which a root counts as explained: the width of the blur on either side of a root."""


@dataclass(frozen=True, kw_only=True)
class PictureScore:
    """Comparison of a result with unused pictures. Pixels are those of the pictures."""

    scene: str
    pictures: int
    """Number of compared pictures."""
    known: int
    """Number of pictures in the dataset that the reconstruction used; they are not compared."""
    iou: float
    """Intersection over union of the covered areas, over all pictures."""
    edge_median_px: float
    """Median distance between the outlines, in both directions."""
    edge_p95_px: float
    line_median_px: float
    """Median distance between the centre lines, in both directions."""
    line_p95_px: float
    explained: float
    """Fraction of the pictures' centre lines within `NEAR_PX` of the projected result."""
    seen: float
    """Fraction of the projected centre lines within `NEAR_PX` of a root in the pictures."""
    per_view: dict[str, float]
    """Area scores by picture."""

    def to_dict(self) -> Json:
        """Convert to JSON values."""
        return asdict(self)

    def table(self) -> str:
        """Format the score as a text table."""
        ignored = f", {self.known} used pictures are ignored" if self.known else ""
        rows = [
            ("pictures", f"{self.pictures} unused{ignored}"),
            ("area", f"intersection over union {100.0 * self.iou:.1f} %"),
            ("outlines apart", f"median {self.edge_median_px:.2f} px, 95 % {self.edge_p95_px:.2f} px"),
            ("centre line distance", f"median {self.line_median_px:.2f} px, 95 % {self.line_p95_px:.2f} px"),
            ("recall of root length", f"{100.0 * self.explained:.1f} %"),
            ("precision of root length", f"{100.0 * self.seen:.1f} %"),
        ]
        return table_of(f"{self.scene}, compared with unused pictures", rows)


def score_pictures(result: Result | Path | str, dataset: Dataset | Path | str, *, monitor: Monitor) -> PictureScore:
    """Compare a result with the pictures of a dataset that were not used in its reconstruction.

    Cameras and coverage of the pictures are estimated as in a reconstruction; nothing is fitted to the result.

    Parameters
    ----------
    result : Result or path
        Result, or its folder.
    dataset : Dataset or path
        Dataset of the same plant on the same rig: the complete scan of which the result used a part, or another scan.
    monitor : Monitor
        Progress monitor.

    Raises
    ------
    UserError
        If all pictures were used, or cannot be read.
    """
    found = result if isinstance(result, Result) else load_result(result)
    dataset = dataset if isinstance(dataset, Dataset) else load_dataset(dataset)
    if dataset.sha256 and dataset.sha256 == found.dataset_sha256:
        raise UserError(f"{dataset.folder} is the dataset of the result; give a dataset with pictures that were not used")
    pictures = verify_curve(read_pictures(dataset, monitor=monitor), monitor=monitor)
    used = {camera.sha256: camera for camera in found.cameras if camera.sha256 and camera.used}
    cameras = find_cameras(pictures, monitor=monitor)
    same = {k: used[sha256] for k, frame in enumerate(pictures.frames) if (sha256 := picture_hash(dataset, frame)) in used}
    cameras = _in_frame_of(found, cameras, same, bare=dataset.scene.strip.rows == 0)
    cameras, coverage = measure_coverage(pictures, cameras, monitor=monitor)
    chosen = [k for k in cameras.order if k not in same]
    if not chosen:
        raise UserError(f"{dataset.folder}: all pictures with a camera were used in the reconstruction; give a dataset with other pictures")
    mesh = found.solid.surface

    def one(k: int) -> Compared:
        return compare(drawn.coverage(cameras.by_frame[k], cameras.optics, mesh, found.roots), coverage.silhouettes[k])

    with monitor.stage("score"):
        compared = monitor.each(one, "score", chosen)
    return gather(found.scene, [pictures.frames[k].file for k in chosen], compared, known=len(same))


def _in_frame_of(found: Result, cameras: Cameras, same: dict[int, Camera], *, bare: bool) -> Cameras:
    """Return the cameras in the canister frame of the result, with its refractive index of the water.

    Markers define the frame. Without markers the frame starts at the first picture, and pictures common to both scans
    give the angle between them.
    """
    n_water = found.rig.get("n_water")
    optics = cameras.optics if n_water is None else replace(cameras.optics, n_water=float(n_water))
    if not bare:
        return replace(cameras, optics=optics)
    turns = [
        frames.to_rotvec(frames.invert(cameras.pose(k)) @ camera.cam_from_canister)[2]
        for k, camera in same.items()
        if camera.cam_from_canister is not None and cameras.all[k].cam_from_canister is not None
    ]
    if not turns:
        raise UserError(
            "without markers, the dataset must include some of the pictures that the result was reconstructed from; give the complete scan"
        )
    turned = frames.rotation_z(float(np.angle(np.mean(np.exp(1j * np.array(turns))))))
    every = tuple(
        camera if camera.cam_from_canister is None else replace(camera, cam_from_canister=camera.cam_from_canister @ turned)
        for camera in cameras.all
    )
    return replace(cameras, all=every, optics=optics)


@dataclass(frozen=True)
class Compared:
    """Comparison of one picture with the projected result."""

    both_px2: float
    either_px2: float
    edges_px: NDArray[np.float32]
    """(N,) distances between the outlines, at both outlines."""
    lines_px: NDArray[np.float32]
    """(N,) distances between the centre lines, where one is near the other's root."""
    explained: tuple[float, float]
    """Length of the picture's centre lines near the projected result, and total length, px."""
    seen: tuple[float, float]
    """Length of the projected centre lines near a root in the picture, and total length."""


def compare(shape: Image, picture: Silhouette) -> Compared:
    """Compare the projected coverage (H, W) with a picture within its valid region."""
    shown, made = signed_distance(picture), signed_distance(Silhouette(shape, picture.usable))
    told = shown < UNSEEN_PX
    root, own = (shown > 0.0) & told, (made > 0.0) & told
    apart = np.abs(made - shown)[(_rim(root) | _rim(own)) & told]
    explained, off = _along(root, own)
    seen, back = _along(own, root)
    return Compared(
        both_px2=float((root & own).sum()) / UPSAMPLING**2,
        either_px2=float((root | own).sum()) / UPSAMPLING**2,
        edges_px=apart,
        lines_px=np.concatenate([off, back]),
        explained=explained,
        seen=seen,
    )


def _rim(inside: Mask) -> Mask:
    """Return the samples next to an outline, on its inside."""
    return inside & ~ndimage.binary_erosion(inside, border_value=1)


def _along(one: Mask, other: Mask) -> tuple[tuple[float, float], NDArray[np.float32]]:
    """Return the length of the centre lines of one image near the area of the other, and the total length.

    The distances of that part from the other centre lines are also returned; all in px.
    """
    line, line_of_other = skeletonize(one), skeletonize(other)
    if not line.any() or not line_of_other.any():
        return (0.0, float(line.sum()) / UPSAMPLING), np.zeros(0, np.float32)
    near = line & (ndimage.distance_transform_edt(~other) <= NEAR_PX * UPSAMPLING)
    off = ndimage.distance_transform_edt(~line_of_other)[near] / UPSAMPLING
    return (float(near.sum()) / UPSAMPLING, float(line.sum()) / UPSAMPLING), off.astype(np.float32)


def gather(scene: str, files: Sequence[str], found: Sequence[Compared], *, known: int) -> PictureScore:
    """Combine the comparisons of all pictures.

    Parameters
    ----------
    scene : str
        Name of the scene.
    files : sequence of str
        File names of the pictures.
    found : sequence of Compared
        Comparison of each picture.
    known : int
        Number of pictures that the reconstruction used.

    Returns
    -------
    PictureScore
        Combined score and scores of each picture.
    """

    def share(parts: Sequence[tuple[float, float]]) -> float:
        near, whole = np.sum(parts, axis=0)
        return float(near / whole) if whole > 0.0 else 1.0

    edges, lines = (np.concatenate([getattr(one, name) for one in found]) for name in ("edges_px", "lines_px"))
    edge, line = (np.quantile(values, [0.5, 0.95]) if len(values) else np.full(2, np.inf) for values in (edges, lines))
    return PictureScore(
        scene=scene,
        pictures=len(found),
        known=known,
        iou=share([(one.both_px2, one.either_px2) for one in found]),
        edge_median_px=float(edge[0]),
        edge_p95_px=float(edge[1]),
        line_median_px=float(line[0]),
        line_p95_px=float(line[1]),
        explained=share([one.explained for one in found]),
        seen=share([one.seen for one in found]),
        per_view={file: share([(one.both_px2, one.either_px2)]) for file, one in zip(files, found, strict=True)},
    )
