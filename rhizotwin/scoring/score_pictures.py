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
"""Maximum distance, in pixels, at which a point of a centre line matches a root. Centre lines of the pictures are
matched with projected roots, and vice versa. Blur widens a root by this distance on either side."""


@dataclass(frozen=True, kw_only=True)
class PictureScore:
    """Agreement of a result with pictures that were not used in its reconstruction, in pixels of these pictures."""

    scene: str
    """Name of the scene."""
    pictures: int
    """Number of compared pictures."""
    known: int
    """Number of pictures of the dataset that were used in the reconstruction and are therefore not compared."""
    iou: float
    """Intersection over union of the covered areas in all compared pictures."""
    edge_median_px: float
    """Median distance between the outlines of the projected result and of the roots in the pictures, px. Distances are
    measured at points on both outlines."""
    edge_p95_px: float
    """95th percentile of the distance between the outlines, pixels."""
    line_median_px: float
    """Median distance between the centre lines of the projected result and of the roots in the pictures, px. Distances
    are measured at points on both centre lines."""
    line_p95_px: float
    """95th percentile of the distance between the centre lines, pixels."""
    explained: float
    """Fraction of the centre-line length in the pictures that lies within `NEAR_PX` of the projected result
    (recall)."""
    seen: float
    """Fraction of the centre-line length of the projected result that lies within `NEAR_PX` of a root in the pictures
    (precision). It is 0 if the projected result is empty, but the pictures show roots."""
    per_view: dict[str, float]
    """Intersection over union of the covered areas in each picture, keyed by file name."""

    def to_dict(self) -> Json:
        """Convert the score to values that the json module can write."""
        return asdict(self)

    def table(self) -> str:
        """Return the score as a text table."""
        ignored = f"; {self.known} used pictures were excluded" if self.known else ""
        rows = [
            ("pictures", f"{self.pictures} unused pictures were compared{ignored}"),
            ("area", f"intersection over union {100.0 * self.iou:.1f} %"),
            ("outline distance", f"median {self.edge_median_px:.2f} px, 95 % {self.edge_p95_px:.2f} px"),
            ("centre line distance", f"median {self.line_median_px:.2f} px, 95 % {self.line_p95_px:.2f} px"),
            ("recall of root length", f"{100.0 * self.explained:.1f} %"),
            ("precision of root length", f"{100.0 * self.seen:.1f} %"),
        ]
        return table_of(f"{self.scene}, compared with unused pictures", rows)


def score_pictures(result: Result | Path | str, dataset: Dataset | Path | str, *, monitor: Monitor) -> PictureScore:
    """Compare a result with the pictures of a dataset that were not used in its reconstruction.

    The cameras of these pictures and the coverage of their pixels are estimated with the methods of a reconstruction,
    but independently of the result.

    Parameters
    ----------
    result : Result or path
        Result, or the result's folder.
    dataset : Dataset or path
        Dataset of the same plant on the same rig: another scan, or the complete scan if the result used only a part.
    monitor : Monitor
        Progress monitor.

    Raises
    ------
    UserError
        If all pictures were used in the reconstruction, or a picture cannot be read.
    """
    found = result if isinstance(result, Result) else load_result(result)
    dataset = dataset if isinstance(dataset, Dataset) else load_dataset(dataset)
    if dataset.sha256 and dataset.sha256 == found.dataset_sha256:
        raise UserError(
            f"{dataset.folder} is the dataset of the result; specify a dataset with pictures that were not used in the reconstruction"
        )
    pictures = verify_curve(read_pictures(dataset, monitor=monitor), monitor=monitor)
    used = {camera.sha256: camera for camera in found.cameras if camera.sha256 and camera.used}
    cameras = find_cameras(pictures, monitor=monitor)
    same = {k: used[sha256] for k, frame in enumerate(pictures.frames) if (sha256 := picture_hash(dataset, frame)) in used}
    cameras = _to_result_frame(found, cameras, same, bare=dataset.scene.strip.rows == 0)
    cameras, coverage = measure_coverage(pictures, cameras, monitor=monitor)
    chosen = [k for k in cameras.order if k not in same]
    if not chosen:
        raise UserError(
            f"{dataset.folder}: all pictures with a camera were used in the reconstruction; specify a dataset with other pictures"
        )
    mesh = found.solid.surface

    def one(k: int) -> Compared:
        return compare(drawn.coverage(cameras.by_frame[k], cameras.optics, mesh, found.roots), coverage.silhouettes[k])

    with monitor.stage("score"):
        compared = monitor.each(one, "score", chosen)
    return gather(found.scene, [pictures.frames[k].file for k in chosen], compared, known=len(same))


def _to_result_frame(found: Result, cameras: Cameras, same: dict[int, Camera], *, bare: bool) -> Cameras:
    """Transform cameras to the canister frame of the result, and use its refractive index of the water.

    Markers define the canister frame. Without markers the azimuth of the frame is that of the first picture, and the
    angle between both frames is computed from pictures that both scans contain.
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
            "without markers, the dataset must include pictures that were used in the reconstruction; specify the complete scan"
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
    """Area of the intersection of both silhouettes, square pixels."""
    either_px2: float
    """Area of the union of both silhouettes, square pixels."""
    edges_px: NDArray[np.float32]
    """Distances (N,) between the outlines, px, measured at points on both outlines."""
    lines_px: NDArray[np.float32]
    """Distances (N,) between the centre lines, px. Points of a centre line that match no root are excluded (see
    `NEAR_PX`)."""
    explained: tuple[float, float]
    """Length of the picture's centre lines that lie near the projected result, and total length of the picture's centre
    lines, px."""
    seen: tuple[float, float]
    """Length of the projected centre lines that lie near a root in the picture, and total length of the projected
    centre lines, px."""


def compare(shape: Image, picture: Silhouette) -> Compared:
    """Compare the projected coverage (H, W) of a result with a picture, in the usable pixels of the picture."""
    shown = signed_distance(picture)
    made = signed_distance(Silhouette(shape, picture.usable))
    told = shown < UNSEEN_PX
    root, own = (shown > 0.0) & told, (made > 0.0) & told
    apart = np.abs(made - shown)[(_outline_samples(root) | _outline_samples(own)) & told]
    explained, off = _compare_centre_lines(root, own)
    seen, back = _compare_centre_lines(own, root)
    return Compared(
        both_px2=float((root & own).sum()) / UPSAMPLING**2,
        either_px2=float((root | own).sum()) / UPSAMPLING**2,
        edges_px=apart,
        lines_px=np.concatenate([off, back]),
        explained=explained,
        seen=seen,
    )


def _outline_samples(inside: Mask) -> Mask:
    """Return which pixels inside an area (H, W) are next to its outline."""
    return inside & ~ndimage.binary_erosion(inside, border_value=1)


def _compare_centre_lines(one: Mask, other: Mask) -> tuple[tuple[float, float], NDArray[np.float32]]:
    """Compare the centre lines of an area (H, W) with a second area (H, W).

    Return the length of the centre lines that lie near the second area, their total length, and the distances (N,) of
    the near part from the centre lines of the second area, all in pixels.
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
        Comparisons of the pictures.
    known : int
        Number of pictures that were used in the reconstruction.

    Returns
    -------
    PictureScore
        Score of all pictures together, with the agreement of each picture.
    """

    def share(parts: Sequence[tuple[float, float]], *, of_nothing: float = 1.0) -> float:
        near, whole = np.sum(parts, axis=0)
        return float(near / whole) if whole > 0.0 else of_nothing

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
        seen=share([one.seen for one in found], of_nothing=0.0 if any(one.explained[1] for one in found) else 1.0),
        per_view={file: share([(one.both_px2, one.either_px2)]) for file, one in zip(files, found, strict=True)},
    )
