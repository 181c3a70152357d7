"""Shapes of nodes of the finest size, and distance maps."""

from dataclasses import replace

import mitsuba as mi
import numpy as np

from rhizotwin.recon.coverage.silhouettes import UPSAMPLING, Window
from rhizotwin.recon.device import numbers
from rhizotwin.recon.hull.distance_maps import DistanceMaps
from rhizotwin.recon.hull.leaves import Grid, Leaves


def block(grid: Grid, index: np.ndarray, occupancy: np.ndarray | float = 1.0) -> Leaves:
    """Return the nodes (N, 3) of a grid, equally full or each with its own occupancy (N,)."""
    count = len(index)
    return Leaves(grid, index.astype(np.int32), np.ones(count, np.int32), np.full(count, occupancy, np.float32))


def everything(grid: Grid, size: int = 1) -> Leaves:
    """Return all of a grid, in leaves of a size in finest nodes."""
    index = size * np.argwhere(np.ones(np.array(grid.coarse_shape) * 2**grid.levels // size, bool))
    return replace(block(grid, index), size=np.full(len(index), size, np.int32))


def maps_of(pictures: np.ndarray) -> DistanceMaps:
    """Return distance maps (V, 2 h, 2 w) of whole pictures, px, on the device."""
    size_px = pictures.shape[2] // UPSAMPLING, pictures.shape[1] // UPSAMPLING
    return DistanceMaps(mi.Float16(numbers(pictures)), size_px, Window((0, 0), size_px))
