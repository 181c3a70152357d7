"""Extraction of the hull's centre lines by morphological thinning."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree
from skimage import morphology

from rhizotwin.recon.hull.leaves import Leaves
from rhizotwin.recon.hull.surface import paint

Array = NDArray[np.float64]

_SKELETON_MM = 0.5
"""Approximate edge length of the voxels used for thinning, mm. Finer voxels cause spurious branches on rough
surfaces."""
_SPACING_MM = 0.16
"""Maximum spacing of points along a centre line, mm. At this spacing, the spheres around successive points in a root
with a diameter of 0.5 mm overlap by more than half."""
_BESIDE = 1.5
"""Distance from a centre line of the first thinning, in voxels, within which a voxel of the second thinning is a
duplicate. The second thinning uses a lattice shifted by half a voxel."""
_WIDE = 2.0
"""Minimum depth of a part of the hull, in voxels, below which thinning may delete it: it has no room for a curve."""


def centre_lines(leaves: Leaves) -> Array:
    """Return densely spaced points (N, 3) on the hull's centre lines, canister frame, mm.

    The hull is thinned to curves. Thinning deletes straight roots whose width is an even number of voxels, and shortens
    other roots. Curves found on a second lattice, shifted by half a voxel so that these widths become odd, are
    therefore added, and the deepest points of wide parts without a curve, such as a ball.
    """
    if not len(leaves.size):
        return np.zeros((0, 3))
    voxels = leaves.merge(max(0, int(np.ceil(np.log2(_SKELETON_MM / leaves.grid.size_mm) - 0.25))))
    low = voxels.index.min(axis=0) - 1
    volume = np.zeros((voxels.index + voxels.size[:, None]).max(axis=0) - low + 1, np.float32)
    paint(volume, voxels.index - low, voxels.size, voxels.occupancy)
    voxel_mm = voxels.grid.size_mm
    nodes = np.argwhere(morphology.skeletonize(volume > 0.5)).astype(np.float64)
    nodes = np.concatenate([nodes, _shifted_curves(volume, nodes)])
    nodes = np.concatenate([nodes, _deepest_points(volume > 0.5, nodes)])
    if not len(nodes):
        return np.zeros((0, 3))
    pairs = cKDTree(nodes).query_pairs(1.8, output_type="ndarray")  # the 26 neighbours, up to a distance of sqrt(3)
    steps = max(1, int(np.ceil(1.4 * voxel_mm / _SPACING_MM)))  # sqrt(2): most neighbours share an edge
    share = (np.arange(1, steps) / steps)[None, :, None]
    between = nodes[pairs[:, 0]][:, None] * (1 - share) + nodes[pairs[:, 1]][:, None] * share
    points = np.concatenate([nodes, between.reshape(-1, 3)])
    return np.asarray(leaves.grid.origin_mm) + (points + low + 0.5) * voxel_mm


def _shifted_curves(volume: NDArray[np.float32], curves: Array) -> Array:
    """Thin the hull on a lattice shifted by half a voxel. Return the voxels (M, 3) of curves that are not yet known.

    The known curves (N, 3) are those found on the original lattice.
    """
    aside = (
        ndimage.uniform_filter(volume, 2, mode="constant") > 0.5
    )  # element i covers the last half of voxel i - 1 and the first half of voxel i
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


def _deepest_points(inside: NDArray[np.bool_], curves: Array) -> Array:
    """Return the deepest voxels (M, 3) of a hull whose largest spheres contain no point (N, 3) of a curve."""
    depth = ndimage.distance_transform_edt(inside)
    deepest = np.argwhere((depth > _WIDE) & (depth == ndimage.maximum_filter(depth, 3)))
    radius = depth[tuple(deepest.T)]
    if len(curves):
        empty = cKDTree(curves).query(deepest)[0] > radius
        deepest, radius = deepest[empty], radius[empty]
    found: list[NDArray[np.int64]] = []
    for voxel in deepest[np.argsort(-radius, kind="stable")]:
        if all(np.linalg.norm(voxel - other) > depth[tuple(other)] for other in found):
            found.append(voxel)
    return np.array(found, np.float64).reshape(-1, 3)
