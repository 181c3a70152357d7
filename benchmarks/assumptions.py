"""Which of the thesis's assumptions turn the sign and the size of its error: its method with some of them changed.

Poses, strip, silhouettes and blindness are changed in the reconstruction; what becomes of voxels that are partly inside
is counted three ways from the same hull.
"""

import itertools
import json
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
from skimage import filters

from benchmarks import cache, datasets
from benchmarks.cases import DEFAULT_VOXEL_MM, Pictures
from benchmarks.run import Say
from rhizotwin import sources
from rhizotwin.recon import shaping
from rhizotwin.recon.calibration.cameras import Cameras
from rhizotwin.recon.calibration.find_cameras import find_cameras
from rhizotwin.recon.coverage import silhouettes
from rhizotwin.recon.coverage.measure import Coverage, measure_coverage
from rhizotwin.recon.coverage.silhouettes import Image, Mask, Silhouette
from rhizotwin.recon.pictures import read_pictures
from rhizotwin.scenes import atomic
from rhizotwin.scenes.dataset import Dataset, load_dataset
from rhizotwin.scenes.monitor import Monitor
from rhizotwin.scenes.truth import load_truth

Poses = Literal["picture", "one row", "scan"]
Outlines = Literal["edges", "dark", "coverage"]
LEVELS = 6
"""Sizes of the finest voxel: the thesis's 0.27 mm and five doublings, 8.64 mm."""
_WHOLE = 0.999
"""Occupancy from which a voxel counts as whole."""
_KEY = ("benchmarks.assumptions",)


@dataclass(frozen=True, kw_only=True)
class Assumptions:
    """What the reconstruction takes for granted; the defaults are the thesis's."""

    poses: Poses = "picture"
    """picture: a pose a picture from both rows of the strip; one row: the same below a strip that has one; scan: of all
    pictures together, the canister's own pose with it."""
    outlines: Outlines = "edges"
    """edges: Otsu's threshold joined with Sobel edges, then opened (T3.4.2); dark: Otsu's threshold alone; coverage:
    how much of each pixel is covered."""
    blind_carves: bool = True
    """Whether a view that cannot see a voxel carves it."""


@dataclass(frozen=True, kw_only=True)
class Counted:
    """What a hull's volume is, over the true one less 1, by what becomes of voxels that are partly inside."""

    assumed: Assumptions
    kept: float
    """Each counts as a whole."""
    shared: float
    """By the part of it that is inside."""
    dropped: float
    """None counts."""


def every() -> list[Assumptions]:
    """Return all combinations, the thesis's own first."""
    poses: tuple[Poses, ...] = ("picture", "one row", "scan")
    outlines: tuple[Outlines, ...] = ("edges", "dark", "coverage")
    chosen = itertools.product(poses, outlines, (True, False))
    return [Assumptions(poses=pose, outlines=outline, blind_carves=blind) for pose, outline, blind in chosen]


def measure(pictures: Pictures, *, say: Say, only_kept: bool = False) -> list[Counted]:
    """Measure every combination on a dataset; what an earlier run with this code measured is kept.

    Parameters
    ----------
    pictures : Pictures
        The dataset.
    say : Say
        Hears every combination's errors.
    only_kept : bool
        Take what was measured before and run nothing.

    Returns
    -------
    list of Counted
        Errors of the volume, a combination each.
    """
    found: list[Counted] = []
    scan: _Scan | None = None
    wanted, keep = every(), _Keep.of(pictures)
    for number, assumed in enumerate(wanted, start=1):
        path = keep.place(asdict(assumed))
        head = f"[{number}/{len(wanted)}] {pictures.name}: {_words(assumed)}"
        if path.is_file():
            found.append(Counted(**{**json.loads(path.read_text(encoding="utf-8")), "assumed": assumed}))
            say(f"{head}: kept")
        elif not only_kept:
            scan = scan or _Scan(pictures)
            mm3, true_mm3 = scan.volumes(assumed), load_truth(scan.dataset().folder).volume_mm3
            counted = Counted(assumed=assumed, **{name: value / true_mm3 - 1.0 for name, value in mm3.items()})
            atomic.write_json(path, asdict(counted))
            found.append(counted)
            say(f"{head}: {100.0 * counted.kept:+.1f}, {100.0 * counted.shared:+.1f}, {100.0 * counted.dropped:+.1f} %")
    return found


@dataclass(frozen=True)
class _Keep:
    """Where what is measured on some pictures with this code is kept."""

    dataset: str
    code: str

    @classmethod
    def of(cls, pictures: Pictures) -> "_Keep":
        return cls(datasets.place(pictures).name, sources.digest(_KEY))

    def place(self, settings: dict[str, Any]) -> Path:
        key = cache.key({"dataset": self.dataset, **settings}, sources=self.code)
        return cache.folder() / "assumptions" / f"{key}.json"


class _Scan:
    """Some pictures, with the cameras by each assumption and the coverage by the last."""

    def __init__(self, pictures: Pictures) -> None:
        self._pictures = pictures
        self._datasets: dict[bool, Dataset] = {}
        self._cameras: dict[Poses, Cameras] = {}
        self._coverage: dict[tuple[Poses, Outlines], Coverage] = {}

    def dataset(self, *, one_row: bool = False) -> Dataset:
        """Return the pictures, or those of the same specimen below a strip that has the upper row alone."""
        if one_row not in self._datasets:
            self._datasets[one_row] = _below_one_row(self._pictures) if one_row else load_dataset(datasets.make(self._pictures))
        return self._datasets[one_row]

    def volumes(self, assumed: Assumptions, finest_mm: float = DEFAULT_VOXEL_MM) -> dict[str, float]:
        """Return the hull's volume (mm3), counted three ways."""
        key, dataset = (assumed.poses, assumed.outlines), self.dataset(one_row=assumed.poses == "one row")
        if assumed.poses not in self._cameras:
            self._cameras[assumed.poses] = _cameras(dataset, joint=assumed.poses == "scan")
        cameras = self._cameras[assumed.poses]
        if key not in self._coverage:
            self._coverage = {key: _coverage(dataset, cameras, assumed.outlines)}  # one at a time in memory
        return _volumes(dataset, cameras, self._coverage[key], assumed, finest_mm)


def _words(assumed: Assumptions) -> str:
    return f"poses {assumed.poses}, outlines {assumed.outlines}, blind views {'carve' if assumed.blind_carves else 'say nothing'}"


def _below_one_row(pictures: Pictures) -> Dataset:
    """Render pictures with the upper row of the strip alone, once (resuming where it was cut off)."""
    from rhizotwin.sim.simulate import simulate

    scene = pictures.scene_to_render()
    strip = scene.strip
    upper = replace(strip, rows=1, bottom_mm=strip.bottom_mm + (strip.rows - 1) * strip.row_pitch_mm)
    folder = cache.folder() / "assumptions" / f"one-row-{datasets.place(pictures).name}"
    if not (folder / "dataset.json").is_file():
        simulate(replace(scene, strip=upper), folder, profile_name=pictures.profile, seed=pictures.seed)
    return load_dataset(folder)


def _cameras(dataset: Dataset, *, joint: bool) -> Cameras:
    """Find the cameras of all pictures together, or each by itself as the thesis does."""
    pictures = read_pictures(dataset, monitor=Monitor())
    return find_cameras(pictures, monitor=Monitor(), measure=joint, single_view=not joint)


def _coverage(dataset: Dataset, cameras: Cameras, outlines: Outlines) -> Coverage:
    pictures = read_pictures(dataset, monitor=Monitor())
    if outlines == "coverage":
        return measure_coverage(pictures, cameras, monitor=Monitor())[1]
    drawn = silhouettes.thesis if outlines == "edges" else _dark
    return measure_coverage(pictures, cameras, monitor=Monitor(), outline=lambda image, _, seen: drawn(image, seen))[1]


def _dark(image: Image, seen: Mask) -> Silhouette:
    """Return Otsu's threshold alone, opened as the thesis does."""
    if not seen.any():
        return Silhouette(np.zeros(image.shape, np.float32), seen)
    dark = ((image < filters.threshold_otsu(image[seen])) & seen).astype(np.uint8)
    opened = cv2.morphologyEx(dark, cv2.MORPH_OPEN, np.ones((2, 2), np.uint8))
    return Silhouette(opened.astype(np.float32), seen)


def _volumes(
    dataset: Dataset, cameras: Cameras, coverage: Coverage, assumed: Assumptions, finest_mm: float = DEFAULT_VOXEL_MM
) -> dict[str, float]:
    """Return the hull's volume (mm3), counted three ways."""
    carved = shaping.carve_hull(
        dataset, cameras, coverage, finest_mm=finest_mm, slack_px=0.0, ignore_blindness=assumed.blind_carves, monitor=Monitor()
    )
    leaves = carved.hull.leaves
    cubes = (leaves.size * leaves.grid.size_mm).astype(np.float64) ** 3
    return {
        "kept": float(cubes.sum()),
        "shared": float(leaves.occupancy @ cubes),
        "dropped": float(cubes[leaves.occupancy > _WHOLE].sum()),
    }


@dataclass(frozen=True, kw_only=True)
class Level:
    """One depth of the octree."""

    voxel_mm: float
    thesis_ml: float
    """The thesis's method: voxels partly inside are kept."""
    thesis_s: float
    ours_ml: float
    """Our hull: by the part that is inside."""
    ours_s: float


def levels(pictures: Pictures, *, say: Say, only_kept: bool = False) -> list[Level]:
    """Carve a dataset with ever finer voxels by both methods, the coarsest first.

    The seconds are of the carving alone, which is compiled before it is timed.

    Parameters
    ----------
    pictures : Pictures
        The dataset.
    say : Say
        Hears every level.
    only_kept : bool
        Take what was measured before and run nothing.

    Returns
    -------
    list of Level
        Volumes and times by both methods.
    """
    path = _Keep.of(pictures).place({"levels": LEVELS})
    if path.is_file():
        return [Level(**one) for one in json.loads(path.read_text(encoding="utf-8"))]
    if only_kept:
        return []
    scan = _Scan(pictures)
    voxels = [DEFAULT_VOXEL_MM * 2 ** (LEVELS - 1 - number) for number in range(LEVELS)]
    told: list[list[tuple[dict[str, float], float]]] = []
    for assumed in (Assumptions(), Assumptions(poses="scan", outlines="coverage", blind_carves=False)):
        told.append([])
        for voxel_mm in voxels:
            scan.volumes(assumed, voxel_mm)
            began = time.perf_counter()
            told[-1].append((scan.volumes(assumed, voxel_mm), time.perf_counter() - began))
            say(f"voxels of {voxel_mm:g} mm: {told[-1][-1][1]:.2f} s")
    found = [
        Level(voxel_mm=voxel_mm, thesis_ml=theirs["kept"] / 1e3, thesis_s=theirs_s, ours_ml=ours["shared"] / 1e3, ours_s=ours_s)
        for voxel_mm, (theirs, theirs_s), (ours, ours_s) in zip(voxels, *told, strict=True)
    ]
    atomic.write_json(path, [asdict(one) for one in found])
    return found


def table(counted: Sequence[Counted]) -> str:
    """Return the combinations as a table (Markdown)."""
    rows = ["| poses | outlines | blind views | partial voxels kept | shared | dropped |", "|---|---|---|---|---|---|"]
    for one in counted:
        errors = " | ".join(f"{100.0 * value:+.1f} %" for value in (one.kept, one.shared, one.dropped))
        rows.append(
            f"| {one.assumed.poses} | {one.assumed.outlines} | {'carve' if one.assumed.blind_carves else 'say nothing'} | {errors} |"
        )
    return "\n".join(rows)
