"""Carving of the visual hull from the silhouettes of all views."""

import math
from dataclasses import dataclass, replace

import numpy as np

from rhizotwin.recon.calibration.cameras import Cameras
from rhizotwin.recon.coverage.measure import Coverage
from rhizotwin.recon.coverage.silhouettes import Silhouette
from rhizotwin.recon.hull import agreement, carve
from rhizotwin.recon.hull.carve import Water
from rhizotwin.recon.hull.distance_maps import DistanceMaps
from rhizotwin.recon.hull.leaves import Hull
from rhizotwin.recon.optics import projection
from rhizotwin.recon.settings import Settings
from rhizotwin.scenes.dataset import Dataset
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.monitor import Monitor

_MISSED_VIEWS = 8
"""Number of views in which the coverage outside the projected hull is measured. These are the first views in processing
order, which are spread over the turn."""
_MISSED_LEAVES = 100_000
"""Maximum number of octree leaves that are projected to measure the coverage outside the hull. Larger hulls are
subsampled: in a picture, the leaves of a solid are less than one pixel apart, and hide each other."""


@dataclass(frozen=True, kw_only=True)
class CarvedHull:
    """Carved hull with the silhouettes and cameras from which it was carved."""

    hull: Hull
    """The carved visual hull."""
    bank: projection.ViewBank
    """Views of the silhouettes, as arrays on the device for projection."""
    maps: DistanceMaps
    """Distance maps of the silhouettes' outlines."""
    silhouettes: tuple[Silhouette, ...]
    """Silhouettes of the views, in the order of ``bank``."""
    cameras: Cameras
    """Cameras of the views, in the order of ``bank``."""
    water: Water
    """Space in which the hull was carved."""

    @property
    def is_binary(self) -> bool:
        """Whether a silhouette determines its outline only to the pixel."""
        return any(silhouette.binary for silhouette in self.silhouettes)


def carve_hull(
    dataset: Dataset,
    cameras: Cameras,
    coverage: Coverage,
    *,
    finest_mm: float,
    slack_px: float,
    monitor: Monitor,
    min_votes: int | None = None,
) -> CarvedHull:
    """Carve the visual hull of the silhouettes.

    Carving starts with all water between the floor and the net pot.

    Parameters
    ----------
    finest_mm : float
        Edge length of the finest octree nodes, mm.
    slack_px, min_votes : float, int
        See `carve.carve`.

    Raises
    ------
    UserError
        If the silhouettes have no volume in common.
    """
    numbers = sorted(cameras.order)
    order = [numbers[place] for place in carve.spread(len(numbers))]
    cameras = replace(cameras, order=tuple(order))
    with monitor.stage("outlines"):
        drawn = tuple(coverage.silhouettes[k] for k in order)
        maps = DistanceMaps.compute(drawn, "outlines", monitor)
    with monitor.stage("carve"):
        bank = projection.ViewBank.pack(cameras.views, cameras.optics)
        water = water_space(dataset.scene, cameras)
        grid = water.grid(finest_mm)
        with monitor.steps("carve", grid.levels + 1, "level") as step:
            hull = carve.carve(bank, maps, grid, water, min_votes=min_votes, slack_px=slack_px, progress=step)
    if hull.leaves.volume_mm3() == 0.0:
        raise UserError(
            f"{dataset.folder}: the silhouettes have no volume in common, so no shape can be reconstructed. "
            "The camera poses or the scene file do not match the pictures."
        )
    return CarvedHull(hull=hull, bank=bank, maps=maps, silhouettes=drawn, cameras=cameras, water=water)


def find_wrong_views(dataset: Dataset, cameras: Cameras, coverage: Coverage, *, monitor: Monitor) -> dict[int, str]:
    """Find the views that contradict all others.

    The result is the reason for each of these views, keyed by frame number.

    Parameters
    ----------
    dataset, cameras, coverage : Dataset, Cameras, Coverage
        Dataset with the scene, cameras, and silhouettes of the views.
    monitor : Monitor
        Receives progress messages.
    """
    with monitor.stage("wrong views"):
        bank = projection.ViewBank.pack(cameras.views, cameras.optics)
        silhouettes = [coverage.silhouettes[k] for k in cameras.order]
        found = agreement.find_wrong_views(bank, silhouettes, water_space(dataset.scene, cameras))
    return {cameras.order[view]: "it contradicts all other pictures, for example because it is mirrored or cropped" for view in found}


def water_space(scene: Scene, cameras: Cameras) -> Water:
    """Return the space in which roots may lie.

    It extends from the floor to the grid of the net pot, or to the surface of the water if this is lower.
    """
    return Water(cameras.optics.inner_radius_mm, min(scene.water.level_mm, scene.net_pot.grid_z_mm), scene.canister.floor_z_mm)


def find_hull(
    dataset: Dataset, cameras: Cameras, coverage: Coverage, settings: Settings, *, fine: bool = True, monitor: Monitor
) -> CarvedHull:
    """Carve the visual hull of the silhouettes with the voxel size of the settings.

    Parameters
    ----------
    dataset, cameras, coverage : Dataset, Cameras, Coverage
        Dataset with the scene, cameras, and silhouettes of the views.
    settings : Settings
        Voxel size, and slack of the outlines.
    fine : bool
        Whether the finest nodes are at most as large as the settings require. Otherwise, they are voxels.
    monitor : Monitor
        Receives progress messages.
    """
    halvings = max(0, math.ceil(math.log2(settings.voxel_mm / settings.hull.finest_mm))) if fine else 0
    finest_mm = settings.voxel_mm / 2**halvings
    return carve_hull(dataset, cameras, coverage, finest_mm=finest_mm, slack_px=settings.hull.slack_px, monitor=monitor)


def missed_share(carved: CarvedHull) -> float:
    """Return the fraction of the coverage that the projected hull does not explain."""
    leaves = carved.hull.leaves
    leaves = leaves.select(np.s_[:: 1 + len(leaves.size) // _MISSED_LEAVES])
    views = list(range(min(_MISSED_VIEWS, carved.bank.count)))
    edge_mm = leaves.grid.size_mm * leaves.size.astype(np.float64)
    return agreement.compare(carved.bank.select(views), [carved.silhouettes[k] for k in views], leaves.middles_mm, edge_mm).share
