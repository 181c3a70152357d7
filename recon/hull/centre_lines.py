"""Centre lines of a hull by thinning."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree
from skimage import morphology

from rhizotwin.recon.hull.leaves import Leaves
from rhizotwin.recon.hull.surface import paint, to_voxels

Array = NDArray[np.float64]

_SKELETON_MM = 0.5
"""Approximate edge of the voxels that are thinned: finer voxels give spurious branches on rough surfaces."""
_SPACING_MM = 0.16
"""Maximum spacing of points along a curve: spheres of roots of 0.5 mm overlap by more than half."""
_BESIDE = 1.5
"""Maximum distance of a voxel from a curve, in voxels, for it to belong to the curve."""


def centre_lines(leaves: Leaves) -> Array:
    """Thin the hull to curves and sample them densely: (N, 3) points in the canister frame, mm.

    Thinning removes straight roots with an even width in voxels, and shortens others. Curves found on a lattice shifted
    by half a voxel, where these widths are odd, are therefore added.
    """
    units = 2 ** max(0, int(np.ceil(np.log2(_SKELETON_MM / leaves.grid.size_mm) - 0.25)))
    index, size, occupancy = to_voxels(leaves, units)
    low = index.min(axis=0) - 1
    volume = np.zeros((index + size[:, None]).max(axis=0) - low + 1, np.float32)
    paint(volume, index - low, size, occupancy)
    voxel_mm = leaves.grid.size_mm * units
    nodes = np.argwhere(morphology.skeletonize(volume > 0.5)).astype(np.float64)
    nodes = np.concatenate([nodes, _shifted_curves(volume, nodes)])
    if not len(nodes):
        return np.zeros((0, 3))
    pairs = cKDTree(nodes).query_pairs(1.8, output_type="ndarray")  # the 26 neighbours, up to a distance of sqrt(3)
    steps = max(1, int(np.ceil(1.4 * voxel_mm / _SPACING_MM)))  # sqrt(2): most neighbours share an edge
    share = (np.arange(1, steps) / steps)[None, :, None]
    between = nodes[pairs[:, 0]][:, None] * (1 - share) + nodes[pairs[:, 1]][:, None] * share
    points = np.concatenate([nodes, between.reshape(-1, 3)])
    return np.asarray(leaves.grid.origin_mm) + (points + low + 0.5) * voxel_mm


def _shifted_curves(volume: NDArray[np.float32], curves: Array) -> Array:
    """Return voxels (M, 3) on curves found on a lattice shifted by half a voxel but not on this one (N, 3)."""
    aside = ndimage.uniform_filter(volume, 2, mode="constant") > 0.5  # element i covers the last half of i - 1, the first of i
    others = np.argwhere(morphology.skeletonize(aside))
    if not len(others) or not len(curves):
        return np.asarray(others - 0.5)
    wide = 2.0 * ndimage.distance_transform_edt(aside)[tuple(others.T)]
    away = cKDTree(curves).query(others - 0.5)[0]
    far = away > wide
    if not far.any():
        return np.zeros((0, 3))
    beside = cKDTree(others[far]).query(others)[0] < wide
    return np.asarray(others[beside & (away > _BESIDE)] - 0.5)
