"""From silhouettes to a shape: outlines, hull, what the silhouettes need of it, surface and size."""

import math
from dataclasses import dataclass

import cv2
import numpy as np

from recon import carve, parsimony, projection, silhouettes, surface
from recon.cameras import View
from recon.refraction import Optics
from recon.result import Shape
from recon.run import Run
from recon.silhouettes import UPSAMPLING, Silhouette
from scenes.errors import UserError

FINEST_MM = 0.14
"""Voxels larger than this are carved finer and gathered, so that their occupancy is measured and not guessed."""
SLACK_PX = 0.3
"""Outline uncertainty that the volume's interval allows for."""
VOTES = 0.3
"""Share of the views that must see a node for it to count."""
_SURFACE_LEAVES = 1_000_000
"""More finest leaves than this are gathered before the surface is drawn."""
Triple = tuple[float, float, float]


@dataclass(frozen=True, kw_only=True)
class Measured:
    """A shape with its size."""

    shape: Shape
    volume_mm3: float
    volume_interval_mm3: tuple[float, float]
    extents_min_mm: Triple
    extents_max_mm: Triple
    blind_mm3: float
    finest_mm: float


def build(run: Run, drawn: dict[int, Silhouette], views: dict[int, View], optics: Optics, *, voxel_mm: float) -> Measured:
    """Carve the silhouettes' hull, trim it, and measure it.

    Raises
    ------
    UserError
        Where the silhouettes have no volume in common.
    """
    thesis = run.method == "thesis"
    order = [list(views)[place] for place in _spread(len(views))]
    with run.stage("outlines"):
        maps = _outlines(run, [drawn[k] for k in order])
    with run.stage("carve"):
        device_maps = carve.DistanceMaps.of(maps)
        del maps
        bank = projection.ViewBank.of([views[k] for k in order], optics)
        hull = _carve(run, bank, device_maps, optics, voxel_mm)
    leaves = hull
    if not thesis:
        with run.stage("trim"):
            leaves, _ = parsimony.trim(bank, device_maps, hull)
    with run.stage("surface"):
        shape = _surface(leaves, voxel_mm)
    volume, interval = _volume(hull, leaves, thesis=thesis)
    low, high = _extents(run, shape)
    return Measured(
        shape=shape,
        volume_mm3=volume,
        volume_interval_mm3=interval,
        extents_min_mm=low,
        extents_max_mm=high,
        blind_mm3=hull.blind_mm3,
        finest_mm=hull.grid.size_mm,
    )


def _spread(count: int) -> list[int]:
    """Order views so that each is far from those before it (golden-ratio steps round the turn): nodes are carved early."""
    return [int(k) for k in np.argsort((np.arange(count) * 0.6180339887498949) % 1.0, kind="stable")]


def _outlines(run: Run, drawn: list[Silhouette]) -> np.ndarray:
    """Return the distance maps (V, 2 H, 2 W) of silhouettes."""
    width, height = run.dataset.scene.camera.image_wh
    maps = np.empty((len(drawn), UPSAMPLING * height, UPSAMPLING * width), np.float32)

    def one(place: int) -> None:
        maps[place] = silhouettes.signed_distance(drawn[place])
        seen = cv2.resize(drawn[place].seen.astype(np.uint8), maps.shape[:0:-1], interpolation=cv2.INTER_NEAREST)
        # at the border of what is seen the distance mixes with that of the unseen: say nothing there
        maps[place][cv2.erode(seen, np.ones((5, 5), np.uint8), borderValue=1) == 0] = carve.UNSEEN_PX

    run.each(one, "outlines", list(range(len(drawn))))
    return maps


def _carve(run: Run, bank: projection.ViewBank, maps: carve.DistanceMaps, optics: Optics, voxel_mm: float) -> carve.Leaves:
    """Carve the water between the floor and the net pot."""
    scene, thesis = run.dataset.scene, run.method == "thesis"
    halvings = 0 if thesis else max(0, math.ceil(math.log2(voxel_mm / FINEST_MM)))
    radius = optics.inner_radius_mm
    top = min(scene.water.level_mm, scene.net_pot.grid_z_mm)
    low, high = np.array([-radius, -radius, scene.canister.floor_z_mm]), np.array([radius, radius, top])
    grid = carve.Grid.over(low, high, voxel_mm / 2**halvings)
    with run.bar("carve", grid.levels + 1, "level") as bar:
        leaves = carve.carve(
            bank,
            maps,
            grid,
            radius_mm=radius,
            min_votes=max(3, math.ceil(VOTES * bank.count)),
            slack_px=0.0 if thesis else SLACK_PX,
            ignore_blindness=thesis,
            progress=bar.update,
        )
    if leaves.volume_mm3() == 0.0:
        raise UserError(
            f"{run.dataset.folder}: the silhouettes have no volume in common, so nothing is left after carving; "
            "the poses or the scene file do not fit the pictures."
        )
    return leaves


def _surface(leaves: carve.Leaves, voxel_mm: float) -> Shape:
    """Gather leaves into voxels, and draw the surface."""
    origin, finest_mm = np.asarray(leaves.grid.origin_mm, np.float64), leaves.grid.size_mm
    index, size, occupancy = surface.to_voxels(leaves, round(voxel_mm / finest_mm))
    units, parts = 1, (leaves.index, leaves.size, leaves.occupancy)
    while len(parts[1]) > _SURFACE_LEAVES:
        units *= 2
        parts = surface.to_voxels(leaves, units)
    mesh = surface.surface(*parts, origin_mm=origin, voxel_mm=units * finest_mm)
    return Shape(index=index, size=size, occupancy=occupancy, origin_mm=origin, voxel_mm=voxel_mm, mesh=mesh)


def _volume(hull: carve.Leaves, leaves: carve.Leaves, *, thesis: bool) -> tuple[float, tuple[float, float]]:
    """Return the volume and its interval: at most the hull with its outlines moved out, at least the trimmed shape moved in."""
    if thesis:  # the thesis counts leaves
        counted = float((leaves.size.astype(np.float64) ** 3).sum() * leaves.grid.size_mm**3)
        return counted, (counted, counted)
    volume = leaves.volume_mm3()
    moved_in = hull.volume_mm3() - hull.volume_mm3(hull.occupancy_low)
    return volume, (max(0.0, volume - moved_in), hull.volume_mm3(hull.occupancy_high))


def _extents(run: Run, shape: Shape) -> tuple[Triple, Triple]:
    """Return the corners of the box round the surface."""
    if len(shape.mesh.vertices):
        low, high = np.asarray(shape.mesh.bounds, np.float64)
    else:
        run.warnings.append("the shape is thinner than the voxels everywhere: the surface is empty; choose a smaller --voxel-mm")
        corners = shape.origin_mm + shape.voxel_mm * shape.index
        low, high = corners.min(axis=0), (corners + shape.voxel_mm * shape.size[:, None]).max(axis=0)
    return (float(low[0]), float(low[1]), float(low[2])), (float(high[0]), float(high[1]), float(high[2]))
