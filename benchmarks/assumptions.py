"""Effect of the thesis's assumptions on the sign and size of its error: its method with some of them changed.

Poses, strip, silhouettes and blindness are changed in the reconstruction; voxels that are partly inside are counted in
three ways for the same hull. `levels` carves the hull with voxels of several sizes, in an octree and in a full grid.
"""

import itertools
import json
import math
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray
from skimage import filters

from benchmarks import cache, datasets
from benchmarks.cases import DEFAULT_VOXEL_MM, Pictures
from benchmarks.output import markdown
from benchmarks.run import Say
from rhizotwin.recon.calibration.cameras import Cameras
from rhizotwin.recon.calibration.find_cameras import find_cameras
from rhizotwin.recon.carved_hull import CarvedHull, carve_hull
from rhizotwin.recon.coverage.measure import Coverage, measure_coverage
from rhizotwin.recon.coverage.silhouettes import Image, Mask, Silhouette
from rhizotwin.recon.hull import carve
from rhizotwin.recon.hull.leaves import Grid, Leaves
from rhizotwin.recon.read_pictures import read_pictures
from rhizotwin.scenes import atomic
from rhizotwin.scenes.dataset import Dataset, load_dataset
from rhizotwin.scenes.monitor import Monitor
from rhizotwin.scenes.truth import load_truth
from rhizotwin.scoring.baselines import thesis_silhouette
from rhizotwin.stored import sources

Poses = Literal["picture", "one row", "scan"]
Outlines = Literal["edges", "dark", "coverage"]
LEVELS = 6
"""Number of sizes of the finest voxel: the thesis's 0.27 mm and five doublings, up to 8.64 mm."""
_SLAB = 64
"""Number of layers of a full grid that are carved together: with voxels of 0.27 mm, 20 million voxels."""
_WHOLE = 0.999
"""Minimum occupancy of a voxel that counts as whole."""
_KEY = ("benchmarks.assumptions",)


@dataclass(frozen=True, kw_only=True)
class Assumptions:
    """Assumptions of the reconstruction; the defaults are those of the thesis."""

    poses: Poses = "picture"
    """picture: one pose per picture, from both rows of the strip; one row: the same for a strip with one row; scan:
    from all pictures together, including the canister's pose."""
    outlines: Outlines = "edges"
    """edges: Otsu's threshold combined with Sobel edges, then a morphological opening (T3.4.2); dark: Otsu's threshold
    alone; coverage: covered fraction of each pixel."""
    blind_carves: bool = True
    """Whether a view in which a voxel is not visible carves it."""


@dataclass(frozen=True, kw_only=True)
class CountedVolumes:
    """Relative error of a hull's volume, by the treatment of voxels that are partly inside."""

    assumed: Assumptions
    kept: float
    """Each counts as whole."""
    shared: float
    """Each counts by its fraction inside."""
    dropped: float
    """None counts."""


def every() -> list[Assumptions]:
    """Return all combinations, with the thesis's own first."""
    poses: tuple[Poses, ...] = ("picture", "one row", "scan")
    outlines: tuple[Outlines, ...] = ("edges", "dark", "coverage")
    chosen = itertools.product(poses, outlines, (True, False))
    return [Assumptions(poses=pose, outlines=outline, blind_carves=blind) for pose, outline, blind in chosen]


def measure(pictures: Pictures, *, say: Say, only_kept: bool = False) -> list[CountedVolumes]:
    """Measure every combination on a dataset; measurements of an earlier run with this code are reused.

    Parameters
    ----------
    pictures : Pictures
        Pictures of the dataset.
    say : Say
        Receives the errors of every combination.
    only_kept : bool
        Whether to use earlier measurements only.

    Returns
    -------
    list of CountedVolumes
        Errors of the volume for each combination.
    """
    found: list[CountedVolumes] = []
    scan: _Scan | None = None
    wanted, keep = every(), _Keep.of(pictures)
    for number, assumed in enumerate(wanted, start=1):
        path = keep.place(asdict(assumed))
        head = f"[{number}/{len(wanted)}] {pictures.name}: {_words(assumed)}"
        if path.is_file():
            found.append(CountedVolumes(**{**json.loads(path.read_text(encoding="utf-8")), "assumed": assumed}))
            say(f"{head}: kept")
        elif not only_kept:
            scan = scan or _Scan(pictures)
            mm3, true_mm3 = _volumes(scan.carve(assumed).hull.leaves), load_truth(scan.dataset().folder).volume_mm3
            counted = CountedVolumes(assumed=assumed, **{name: value / true_mm3 - 1.0 for name, value in mm3.items()})
            atomic.write_json(path, asdict(counted))
            found.append(counted)
            say(f"{head}: {100.0 * counted.kept:+.1f}, {100.0 * counted.shared:+.1f}, {100.0 * counted.dropped:+.1f} %")
    return found


@dataclass(frozen=True)
class _Keep:
    """Cache of measurements on pictures with this code."""

    dataset: str
    code: str

    @classmethod
    def of(cls, pictures: Pictures) -> "_Keep":
        return cls(datasets.place(pictures).name, sources.digest(_KEY))

    def place(self, settings: dict[str, Any]) -> Path:
        key = cache.key({"dataset": self.dataset, **settings}, sources=self.code)
        return cache.folder() / "assumptions" / f"{key}.json"


class _Scan:
    """Pictures with the cameras of each assumption and the coverage of the last one."""

    def __init__(self, pictures: Pictures) -> None:
        self._pictures = pictures
        self._datasets: dict[bool, Dataset] = {}
        self._cameras: dict[Poses, Cameras] = {}
        self._coverage: dict[tuple[Poses, Outlines], Coverage] = {}

    def dataset(self, *, one_row: bool = False) -> Dataset:
        """Return the dataset, or one of the same specimen and a strip with the upper row only."""
        if one_row not in self._datasets:
            self._datasets[one_row] = below_one_row(self._pictures) if one_row else load_dataset(datasets.make(self._pictures))
        return self._datasets[one_row]

    def carve(self, assumed: Assumptions, finest_mm: float = DEFAULT_VOXEL_MM) -> CarvedHull:
        """Carve the hull with voxels of an edge of ``finest_mm``."""
        key, dataset = (assumed.poses, assumed.outlines), self.dataset(one_row=assumed.poses == "one row")
        if assumed.poses not in self._cameras:
            self._cameras[assumed.poses] = _cameras(dataset, joint=assumed.poses == "scan")
        cameras = self._cameras[assumed.poses]
        if key not in self._coverage:
            self._coverage = {key: _coverage(dataset, cameras, assumed.outlines)}  # only one is kept in memory
        return carve_hull(
            dataset,
            cameras,
            self._coverage[key],
            finest_mm=finest_mm,
            slack_px=0.0,
            min_votes=len(cameras.order) if assumed.blind_carves else None,
            monitor=Monitor(),
        )


def _words(assumed: Assumptions) -> str:
    return f"poses {assumed.poses}, outlines {assumed.outlines}, blind views {'carve' if assumed.blind_carves else 'are ignored'}"


def below_one_row(pictures: Pictures) -> Dataset:
    """Return pictures with the upper row of the strip only, rendered once (resuming an interrupted run)."""
    from rhizotwin.sim.simulate import simulate

    scene = pictures.scene_to_render()
    strip = scene.strip
    upper = replace(strip, rows=1, bottom_mm=strip.bottom_mm + (strip.rows - 1) * strip.row_pitch_mm)
    folder = cache.folder() / "assumptions" / f"one-row-{datasets.place(pictures).name}"
    if not (folder / "dataset.json").is_file():
        simulate(replace(scene, strip=upper), folder, profile_name=pictures.profile, seed=pictures.seed)
    return load_dataset(folder)


def _cameras(dataset: Dataset, *, joint: bool) -> Cameras:
    """Calibrate the cameras of all pictures together, or of each separately as in the thesis."""
    pictures = read_pictures(dataset, monitor=Monitor())
    return find_cameras(pictures, monitor=Monitor(), measure=joint, single_view=not joint)


def _coverage(dataset: Dataset, cameras: Cameras, outlines: Outlines) -> Coverage:
    pictures = read_pictures(dataset, monitor=Monitor())
    if outlines == "coverage":
        return measure_coverage(pictures, cameras, monitor=Monitor())[1]
    drawn = thesis_silhouette if outlines == "edges" else dark
    return measure_coverage(pictures, cameras, monitor=Monitor(), outline=lambda image, _, seen: drawn(image, seen))[1]


def dark(image: Image, seen: Mask) -> Silhouette:
    """Return the silhouette (H, W) by Otsu's threshold alone, opened as in the thesis."""
    if not seen.any():
        return Silhouette(np.zeros(image.shape, np.float32), seen)
    shadow = ((image < filters.threshold_otsu(image[seen])) & seen).astype(np.uint8)
    opened = cv2.morphologyEx(shadow, cv2.MORPH_OPEN, np.ones((2, 2), np.uint8))
    return Silhouette(opened.astype(np.float32), seen)


def _volumes(leaves: Leaves) -> dict[str, float]:
    """Return the volume (mm3) of a hull's leaves, counted in three ways."""
    cubes = (leaves.size * leaves.grid.size_mm).astype(np.float64) ** 3
    return {
        "kept": float(cubes.sum()),
        "shared": float(leaves.occupancy @ cubes),
        "dropped": float(cubes[leaves.occupancy > _WHOLE].sum()),
    }


Triple = tuple[float, float, float]


@dataclass(frozen=True, kw_only=True)
class Carved:
    """Hull carved by one method with one size of the finest voxel."""

    ml: float
    """Volume: by the thesis's method with partial voxels kept, by ours with their fractions inside."""
    cpu_s: float
    """Processor time of the carving."""
    voxels: int
    """Number of leaves of the octree."""
    extents_mm: Triple
    """Lengths along x, y and z between the outermost faces of the voxels (T3.5)."""
    grid_cpu_s: float | None = None
    """Processor time with a full grid; None if it was not measured."""
    grid_ml: float | None = None
    """Volume with a full grid, counted as that of the octree; None if it was not measured."""


@dataclass(frozen=True, kw_only=True)
class Level:
    """One depth of the octree."""

    voxel_mm: float
    grid_voxels: int
    """Number of voxels of a full grid, in the box around the water."""
    thesis: Carved
    ours: Carved
    """Our hull, before it is trimmed."""
    true_extents_mm: Triple


def levels(pictures: Pictures, *, say: Say, only_kept: bool = False) -> list[Level]:
    """Carve a dataset with increasingly fine voxels by both methods, the coarsest first.

    Times are those of carving alone, after compilation.

    Parameters
    ----------
    pictures : Pictures
        Pictures of the dataset.
    say : Say
        Receives the result of every level.
    only_kept : bool
        Whether to use earlier measurements only.

    Returns
    -------
    list of Level
        Hulls by both methods.
    """
    path = _Keep.of(pictures).place({"levels": LEVELS})
    if path.is_file():
        kept = json.loads(path.read_text(encoding="utf-8"))
        return [Level(**{**one, "thesis": Carved(**one["thesis"]), "ours": Carved(**one["ours"])}) for one in kept]
    if only_kept:
        return []
    scan = _Scan(pictures)
    truth = load_truth(scan.dataset().folder)
    ends = np.subtract(truth.extents_max_mm, truth.extents_min_mm)
    voxels = [DEFAULT_VOXEL_MM * 2 ** (LEVELS - 1 - number) for number in range(LEVELS)]
    hulls: list[list[tuple[Carved, int]]] = []
    for assumed in (Assumptions(), Assumptions(poses="scan", outlines="coverage", blind_carves=False)):
        hulls.append([])
        for voxel_mm in voxels:
            hulls[-1].append(_timed(scan.carve(assumed, voxel_mm), assumed))
            say(f"voxels of {voxel_mm:g} mm: {hulls[-1][-1][0]}")
    found = [
        Level(voxel_mm=voxel_mm, grid_voxels=number, thesis=theirs, ours=ours, true_extents_mm=_triple(ends))
        for voxel_mm, (theirs, number), (ours, _) in zip(voxels, *hulls, strict=True)
    ]
    atomic.write_json(path, [asdict(one) for one in found])
    return found


def _timed(carved: CarvedHull, assumed: Assumptions) -> tuple[Carved, int]:
    """Carve a hull again for its time, and return it with the number of voxels of a full grid.

    The full grid is carved too, but by the thesis's method only.
    """
    leaves = carved.hull.leaves
    mm3, grid = _volumes(leaves), leaves.grid
    slabs = _slabs(grid)
    is_thesis = assumed == Assumptions()

    votes = carved.bank.count if assumed.blind_carves else None

    def measure(lattices: Sequence[Grid]) -> tuple[float, float]:
        """Return processor time, s, and volume with partial voxels kept, ml."""
        began, kept_mm3 = time.process_time(), 0.0
        for lattice in lattices:
            hull = carve.carve(carved.bank, carved.maps, lattice, carved.water, slack_px=0.0, min_votes=votes)
            kept_mm3 += _volumes(hull.leaves)["kept"]
        return time.process_time() - began, kept_mm3 / 1e3

    full_s, full_ml = measure(slabs) if is_thesis else (None, None)
    low, high = leaves.index.min(axis=0), (leaves.index + leaves.size[:, None]).max(axis=0)
    found = Carved(
        ml=mm3["kept" if is_thesis else "shared"] / 1e3,
        cpu_s=min(measure([grid])[0], measure([grid])[0]),
        voxels=len(leaves.size),
        extents_mm=_triple((high - low) * grid.size_mm),
        grid_cpu_s=full_s,
        grid_ml=full_ml,
    )
    return found, sum(math.prod(slab.coarse_shape) for slab in slabs)


def _slabs(grid: Grid) -> list[Grid]:
    """Return the full grid of an octree's finest voxels, in slabs that fit in memory."""
    x, y, z = (number * 2**grid.levels for number in grid.coarse_shape)
    ends = [(low, min(low + _SLAB, z)) for low in range(0, z, _SLAB)]
    up = np.array([0.0, 0.0, grid.size_mm])
    return [Grid(grid.origin_mm + low * up, grid.size_mm, 0, (x, y, high - low)) for low, high in ends]


def _triple(values: NDArray[np.float64]) -> Triple:
    return float(values[0]), float(values[1]), float(values[2])


def table(counted: Sequence[CountedVolumes]) -> str:
    """Return the combinations as a Markdown table."""
    rows = []
    for one in counted:
        errors = (f"{100.0 * value:+.1f} %" for value in (one.kept, one.shared, one.dropped))
        rows.append([one.assumed.poses, one.assumed.outlines, "carve" if one.assumed.blind_carves else "are ignored", *errors])
    return markdown("poses | outlines | blind views | partial voxels kept | weighted | dropped", rows)
