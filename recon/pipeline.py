"""The whole way from a dataset to a result: read, poses, silhouettes, carve, surface."""

from __future__ import annotations

import importlib.metadata
import math
import resource
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from recon import background, carve, markers, parsimony, poses, projection, result, silhouettes, surface
from recon.cameras import View
from recon.refraction import Optics
from scenes import frames
from scenes.dataset import Dataset, Frame, load_dataset, read_image
from scenes.errors import UserError

T = TypeVar("T")
Method = Literal["coverage", "thesis"]

FINEST_MM = 0.14
"""Voxels larger than this are carved finer and gathered, so that their occupancy is measured and not guessed."""
SLACK_PX = 0.3
"""Outline uncertainty that the volume's interval allows for."""
_MIN_VOTES_FRACTION = 0.2
_VERSIONED = ("mitsuba", "drjit", "numpy", "scipy", "scikit-image", "opencv-python-headless", "trimesh")


@dataclass
class _Run:
    """What the stages share: the data at hand, the bars, the clock and what is to be said at the end."""

    dataset: Dataset
    frames: list[Frame]
    progress: bool
    timings_s: dict[str, float] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time a stage."""
        begin = time.perf_counter()
        yield
        self.timings_s[name] = time.perf_counter() - begin

    def each(self, work: Callable[[int], T], name: str, indices: list[int]) -> list[T]:
        """Do something for views in parallel, with a bar."""
        with ThreadPoolExecutor(max_workers=_threads()) as pool:
            bar = tqdm(pool.map(work, indices), total=len(indices), desc=name, unit="view", disable=not self.progress, dynamic_ncols=True)
            return list(bar)


def _threads() -> int:
    import os

    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def reconstruct(
    dataset_folder: Path, result_folder: Path, *, voxel_mm: float = 0.27, method: Method = "coverage", progress: bool = True
) -> result.Result:
    """Reconstruct a dataset and write a result folder.

    Parameters
    ----------
    voxel_mm : edge of the voxels that are written; measuring inside them is finer (`FINEST_MM`).
    method : ``coverage`` measures coverage, pools all views for the poses and respects blind directions; ``thesis`` is the thesis's
        own way: a pose a picture, binary silhouettes, a strict AND over all views whether they see a voxel or not, counted leaves.

    Raises
    ------
    UserError
        Where the pictures cannot be used; the message names the file and what to do.
    """
    dataset_folder, result_folder = Path(dataset_folder), Path(result_folder)
    dataset = load_dataset(dataset_folder)
    run = _Run(dataset, [frame for frame in dataset.frames if frame.kind == "root"], progress)
    if not run.frames:
        raise UserError(f"{dataset_folder / 'dataset.json'} lists no pictures of the root; take or import some.")
    optics = Optics.of(dataset.scene)
    with run.stage("read"):
        images = run.each(lambda k: read_image(dataset, run.frames[k]), "read", list(range(len(run.frames))))
    found = _poses(run, images, single_view=method == "thesis")
    used = [k for k, view in enumerate(found) if view.used]
    if len(used) < 3:
        reasons = "; ".join(sorted({str(view.reason) for view in found if view.reason}))
        raise UserError(f"{dataset_folder}: only {len(used)} of {len(found)} pictures have a camera pose and at least 3 are needed ({reasons}).")
    views = {k: View(camera=dataset.scene.camera, cam_from_canister=np.array(found[k].cam_from_canister)) for k in used}
    drawn = _silhouettes(run, images, views, optics, method)
    hull, leaves = _carve(run, drawn, views, optics, voxel_mm, method)
    shape = _surface(run, leaves, voxel_mm)
    numbers = _numbers(run, hull, leaves, shape, method)
    for k in used:
        seen = drawn[k].seen
        found[k] = _with_fill(found[k], float((drawn[k].coverage[seen] > 0.5).mean()) if seen.any() else 0.0)
    with run.stage("write"):
        made = result.Result(
            dataset=str(dataset_folder),
            scene=dataset.scene.name,
            voxel_mm=voxel_mm,
            **numbers,
            blind_mm3=leaves.blind_mm3,
            views=tuple(found),
            warnings=tuple(run.warnings),
            timings_s=run.timings_s,
            peak_memory_mib=resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0,
            settings={"method": method, "voxel_mm": voxel_mm, "finest_mm": leaves.grid.size_mm, "slack_px": SLACK_PX},
            versions={name: importlib.metadata.version(name) for name in _VERSIONED},
            shape=shape,
            silhouettes={run.frames[k].file: drawn[k] for k in used},
        )
        result.write(made, result_folder)
    return made


def _with_fill(view: result.ViewResult, fill: float) -> result.ViewResult:
    from dataclasses import replace

    return replace(view, fill=fill)


def _poses(run: _Run, images: list[NDArray[np.generic]], *, single_view: bool) -> list[result.ViewResult]:
    """Find every camera from the markers, or take the given ones."""
    if all(frame.cam_from_canister is not None for frame in run.frames):
        return [
            result.ViewResult(
                file=frame.file,
                ring=frame.ring,
                used=True,
                reason=None,
                cam_from_canister=np.array(frame.cam_from_canister).tolist(),
                reprojection_px=None,
                markers=0,
                table_deg=frame.table_deg,
            )
            for frame in run.frames
        ]
    strip = run.dataset.scene.strip
    with run.stage("markers"):
        detected = run.each(lambda k: markers.detect_markers(images[k], strip), "markers", list(range(len(images))))
    with run.stage("poses"):
        solved = poses.find_poses(detected, run.dataset.scene, run.frames, single_view=single_view)
    found = [
        result.ViewResult(
            file=frame.file,
            ring=frame.ring,
            used=view.used,
            reason=view.reason,
            cam_from_canister=None if view.cam_from_canister is None else view.cam_from_canister.tolist(),
            reprojection_px=view.reprojection_px,
            markers=len(markers_.ids),
            table_deg=view.table_deg,
        )
        for frame, view, markers_ in zip(run.frames, solved.views, detected, strict=True)
    ]
    run.warnings += solved.warnings
    run.warnings += [f"{view.file} is left out: {view.reason}" for view in found if not view.used]
    return found


def _silhouettes(
    run: _Run, images: list[NDArray[np.generic]], views: dict[int, View], optics: Optics, method: Method
) -> dict[int, silhouettes.Silhouette]:
    """Draw every view's silhouette."""
    scene, drawn = run.dataset.scene, {}
    keys = list(views)
    if run.dataset.masks:
        everything = optics.n_wall == 1.0 and optics.n_water == 1.0
        with run.stage("silhouettes"):
            for k in keys:
                picture = images[k].astype(np.float32) / np.iinfo(images[k].dtype).max
                seen = np.ones(picture.shape, bool) if everything else background.water_mask(views[k], optics, scene)
                drawn[k] = silhouettes.Silhouette(np.where(seen, picture, 0.0).astype(np.float32), seen)
    else:
        with run.stage("background"):
            inside = dict(zip(keys, run.each(lambda k: background.water_mask(views[k], optics, scene), "water", keys), strict=True))
            empty = _backgrounds(run, images, views, inside)
        with run.stage("silhouettes"):

            def draw(k: int) -> silhouettes.Silhouette:
                picture = images[k].astype(np.float32)
                seen = background.bright_enough(empty[k], inside[k])
                return silhouettes.thesis(picture, seen) if method == "thesis" else silhouettes.measure(picture, empty[k], seen)

            drawn = dict(zip(keys, run.each(draw, "silhouettes", keys), strict=True))
    nothing = [run.frames[k].file for k in keys if not drawn[k].seen.any()]
    if nothing:
        raise UserError(f"{nothing[0]} shows nothing of the water below the net pot: check the camera, the backlight and the scene file.")
    empty_ones = [run.frames[k].file for k in keys if not (drawn[k].coverage > 0.25).any()]
    if empty_ones:
        raise UserError(
            f"{empty_ones[0]} has an empty silhouette ({len(empty_ones)} of {len(keys)} pictures do): no root is seen in it, "
            "so nothing can be carved; take it out of the dataset or check light and focus."
        )
    return drawn


def _backgrounds(
    run: _Run, images: list[NDArray[np.generic]], views: dict[int, View], inside: dict[int, NDArray[np.bool_]]
) -> dict[int, NDArray[np.float32]]:
    """Estimate the empty backlight of each view: ring by ring where the camera stood still, else picture by picture."""
    empty: dict[int, NDArray[np.float32]] = {}
    for ring in sorted({run.frames[k].ring for k in views}):
        members = [k for k in views if run.frames[k].ring == ring]
        if len(members) >= 8 and _still(run, [views[k] for k in members], [run.frames[k] for k in members]):
            common = np.logical_or.reduce([inside[k] for k in members])
            stack = np.stack([images[k] for k in members]).astype(np.float32)
            estimate = background.estimate(stack, common)
            empty.update(dict.fromkeys(members, estimate))
        else:
            estimates = run.each(lambda k: background.estimate_single(images[k].astype(np.float32), inside[k]), "background", members)
            empty.update(dict(zip(members, estimates, strict=True)))
    return empty


def _still(run: _Run, views: list[View], taken: list[Frame]) -> bool:
    """Tell whether a ring's camera stood still: the pictures' edges of the canister and pot lie within two pixels."""
    rho = np.array([view.rho_mm for view in views])
    height = np.array([view.centre_mm[2] for view in views])
    axis = np.array([frames.apply(view.cam_from_canister, np.array([0.0, 0.0, height.mean()])) for view in views])
    focal = run.dataset.scene.camera.focal_px[0]
    column, row = focal * axis[:, 0] / axis[:, 2], focal * axis[:, 1] / axis[:, 2]
    # The canister may stand off the table's axis by a few millimetres: that is no moving camera.
    limit_px = 4.0 * focal / float(np.median(rho))
    return bool(np.ptp(column) < 2.0 * limit_px and np.ptp(row) < 2.0 * limit_px and np.ptp(rho) < 8.0)


def _carve(
    run: _Run, drawn: dict[int, silhouettes.Silhouette], views: dict[int, View], optics: Optics, voxel_mm: float, method: Method
) -> tuple[carve.Leaves, carve.Leaves]:
    """Carve the hull, and trim it to what the silhouettes need: (hull, shape)."""
    scene, keys = run.dataset.scene, list(views)
    thesis = method == "thesis"
    with run.stage("distance"):
        shape = (silhouettes.UPSAMPLING * scene.camera.image_wh[1], silhouettes.UPSAMPLING * scene.camera.image_wh[0])
        maps = np.empty((len(keys), *shape), np.float32)

        def fill(place: int) -> None:
            silhouette = drawn[keys[place]]
            maps[place] = silhouettes.signed_distance(silhouette)
            unseen = cv2.resize(silhouette.seen.astype(np.uint8), shape[::-1], interpolation=cv2.INTER_NEAREST) == 0
            maps[place][unseen] = carve.UNSEEN_PX

        run.each(fill, "outlines", list(range(len(keys))))
    with run.stage("carve"):
        order = _spread(len(keys))
        device_maps = carve.DistanceMaps.of(maps[order])
        del maps
        bank = projection.ViewBank.of([views[keys[place]] for place in order], optics)
        halvings = 0 if thesis else max(0, math.ceil(math.log2(voxel_mm / FINEST_MM)))
        radius = optics.inner_radius_mm
        top = min(scene.water.level_mm, scene.net_pot.grid_z_mm)
        low, high = np.array([-radius, -radius, scene.canister.floor_z_mm]), np.array([radius, radius, top])
        grid = carve.Grid.over(low, high, voxel_mm / 2**halvings)
        bar = tqdm(total=grid.levels + 1, desc="carve", unit="level", disable=not run.progress, dynamic_ncols=True)
        leaves = carve.carve(
            bank,
            device_maps,
            grid,
            radius_mm=radius,
            min_votes=max(3, math.ceil(_MIN_VOTES_FRACTION * len(keys))),
            slack_px=0.0 if thesis else SLACK_PX,
            ignore_blindness=thesis,
            progress=lambda level, _: bar.update(level - bar.n),
        )
        bar.update(grid.levels + 1 - bar.n)
        bar.close()
    if leaves.volume_mm3() == 0.0:
        raise UserError(
            f"{run.dataset.folder}: the silhouettes have no volume in common, so nothing is left after carving; "
            "the poses or the scene file do not fit the pictures."
        )
    hull = leaves
    if not thesis:
        with run.stage("trim"):
            leaves, _ = parsimony.trim(bank, device_maps, hull)
    return hull, leaves


def _spread(count: int) -> list[int]:
    """Order views so that each is far from those before it (golden-ratio steps round the turn): nodes are carved early."""
    return [int(k) for k in np.argsort((np.arange(count) * 0.6180339887498949) % 1.0, kind="stable")]


def _surface(run: _Run, leaves: carve.Leaves, voxel_mm: float) -> result.Shape:
    """Gather leaves into voxels and draw the surface."""
    with run.stage("surface"):
        units = round(voxel_mm / leaves.grid.size_mm)
        index, size, occupancy = surface.to_voxels(leaves, units)
        origin = np.asarray(leaves.grid.origin_mm, np.float64)
        fine = units > 1 and len(leaves.size) < 1_000_000
        parts = (leaves.index, leaves.size, leaves.occupancy) if fine else (index, size, occupancy)
        mesh = surface.surface(*parts, origin_mm=origin, voxel_mm=leaves.grid.size_mm if fine else voxel_mm)
    return result.Shape(index=index, size=size, occupancy=occupancy, origin_mm=origin, voxel_mm=voxel_mm, mesh=mesh)


def _numbers(run: _Run, hull: carve.Leaves, leaves: carve.Leaves, shape: result.Shape, method: Method) -> dict[str, float | tuple[float, ...]]:
    """Return volume, its interval and the extents."""
    if method == "thesis":
        counted = float((leaves.size.astype(np.float64) ** 3).sum() * leaves.grid.size_mm**3)
        volume, low, high = counted, counted, counted
    else:
        volume = leaves.volume_mm3()
        # at most the hull with its outlines moved out; at least the trimmed shape, less what moving them in costs the hull
        high = hull.volume_mm3(hull.occupancy_high)
        low = volume - (hull.volume_mm3() - hull.volume_mm3(hull.occupancy_low))
    if len(shape.mesh.vertices):
        bounds = np.asarray(shape.mesh.bounds, np.float64)
    else:
        run.warnings.append("the shape is thinner than the voxels everywhere: the surface is empty; choose a smaller --voxel-mm")
        corners = shape.origin_mm + shape.voxel_mm * shape.index
        bounds = np.stack([corners.min(axis=0), (corners + shape.voxel_mm * shape.size[:, None]).max(axis=0)])
    return {
        "volume_mm3": volume,
        "volume_interval_mm3": (low, high),
        "extents_min_mm": tuple(float(x) for x in bounds[0]),
        "extents_max_mm": tuple(float(x) for x in bounds[1]),
    }
