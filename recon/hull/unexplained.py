"""Parts of the silhouettes that a trimmed shape does not explain."""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon import device
from rhizotwin.recon.coverage.silhouettes import UPSAMPLING
from rhizotwin.recon.device import Bool, Float, Point3f, Vector2f, halves, numbers
from rhizotwin.recon.hull import distance_maps
from rhizotwin.recon.hull.distance_maps import DistanceMaps
from rhizotwin.recon.hull.leaves import Leaves
from rhizotwin.recon.hull.spheres import Spheres, beyond_mm
from rhizotwin.recon.optics import projection
from rhizotwin.recon.optics.projection import ViewBank

_DEEP_PX = 0.75
"""Minimum distance inside the outline at which an unexplained pixel requires a part of the hull to be retained, px. The
weight of the pixel increases from 0 at two thirds of this distance to 1 at four thirds."""
_LEAST = 0.25
"""Minimum unexplained fraction of a sample. Samples beside voxels that the surface cuts are unexplained to a few per
cent. Without this limit, two thirds of the nodes beside a printed root were required to 2 % each."""
_NEAREST = 1.5, 2.5
"""Limits between which the weight of a node decreases from 1 to 0, in node edges. The limits apply to the node's
distance from the spheres minus the smallest such distance among all nodes on the same line of sight.

Nodes in the cross-section of a single line of sight are up to 1.4 edges apart."""
_LEAST_EDGE_PX = 0.5
"""Minimum width of the lines of sight on which nodes are compared, px. It is one sample of the distance maps."""


def required_fraction(bank: ViewBank, maps: DistanceMaps, trimmed: Leaves, uncertain: Leaves, spheres: Spheres) -> NDArray[np.float32]:
    """Return the fraction (N,) of each uncertain node that must be added for the shape to explain the silhouettes.

    A residual is computed for each view. The second-largest residual is used, since a single view may be wrong. Of all
    nodes on a line of sight, a view requires those nearest to the spheres. A node of a solid is the nearest in views
    perpendicular to the direction from the node to its sphere. A spike of the hull, where a root hides behind another
    in those views, is not the nearest in any view.

    Parameters
    ----------
    bank, maps : ViewBank, DistanceMaps
        Views, and the distance maps of their silhouettes.
    trimmed : Leaves
        Trimmed shape, which is certain.
    uncertain : Leaves
        Finest nodes that may be required.
    spheres : Spheres
        Spheres from which the distances of nodes are measured.

    Returns
    -------
    (N,) float32 array
        Required fraction of each node, 0 to 1.
    """
    width, height = maps.samples_wh
    voxels, edge_mm = trimmed.merge(1), trimmed.grid.size_mm
    voxels = voxels.select(voxels.occupancy > 0.25).split()
    solid, share = device.points(voxels.middles_mm), numbers(np.clip(2.0 * voxels.occupancy - 0.5, 0.0, 1.0))
    places, beyond = device.points(uncertain.middles_mm), numbers(beyond_mm(spheres, uncertain.middles_mm) / edge_mm)
    most, second = dr.zeros(mi.Float, dr.width(places)), dr.zeros(mi.Float, dr.width(places))
    columns = dr.opaque(mi.UInt32, width)
    for view in range(bank.count):
        px, scale, visible = _project(bank, maps, view, solid)
        place = maps.sample(px) + 0.5
        covered = dr.zeros(mi.Float, width * height)
        dr.scatter_reduce(dr.ReduceOp.Max, covered, share, mi.UInt32(place.y) * columns + mi.UInt32(place.x), visible)
        apart = 2.0 * edge_mm * _masked_maximum(scale, visible) * UPSAMPLING  # samples between adjacent voxels of the solid
        explained = _spread(np.array(covered).reshape(height, width), max(3, 2 * math.ceil(0.5 * apart) - 1))
        values = maps.picture(view)
        deep = np.clip(1.5 * values / _DEEP_PX - 1.0, 0.0, 1.0) * (values < distance_maps.TELLS_PX)
        lacking = (deep * (1.0 - explained)).astype(np.float32)
        lacking[lacking < _LEAST] = 0.0
        if not lacking.any():
            continue
        px, scale, visible = _project(bank, maps, view, places)
        lacks = dr.select(visible, replace(maps, values=halves([_spread(lacking, 5)])).at(0, px, visible), 0.0)
        dr.eval(lacks)
        edge_px = max(edge_mm * _masked_maximum(scale, lacks > 0.0), _LEAST_EDGE_PX)
        lacks *= dr.clip(_NEAREST[1] - (beyond - _nearest(maps, px, beyond, lacks > 0.0, edge_px)), 0.0, 1.0)
        most, second = dr.maximum(most, lacks), dr.maximum(second, dr.minimum(most, lacks))
        dr.eval(most, second)
    return np.array(second)


def _nearest(maps: DistanceMaps, px: Vector2f, beyond: Float, active: Bool, edge_px: float) -> Float:
    """Return the smallest distance from the spheres on the line of sight through each node, in node edges.

    The minimum is taken over all nodes on the line of sight, whose width ``edge_px`` is that of a node.
    """
    width, height = (int(count / edge_px) + 1 for count in maps.image_wh)
    # Opaque, since literal values would require a new kernel for every view.
    last, edge = (mi.Vector2f(*(dr.opaque(mi.Float, part) for part in pair)) for pair in ([n - 1.0 for n in maps.image_wh], [edge_px] * 2))
    place = dr.clip(px + 0.5, 0.0, last) / edge
    at = mi.UInt32(place.y) * dr.opaque(mi.UInt32, width) + mi.UInt32(place.x)
    nearest = dr.full(mi.Float, 1e6, width * height)
    dr.scatter_reduce(dr.ReduceOp.Min, nearest, beyond, at, active)
    return dr.gather(mi.Float, nearest, at, active)


def _masked_maximum(value: Float, active: Bool) -> float:
    return float(dr.max(dr.select(active, value, 0.0))[0])


def _spread(picture: NDArray[np.float32], edge: int) -> NDArray[np.float32]:
    """Dilate an image (H, W) with a square of odd edge length, and blur it with a 3 x 3 box filter."""
    return np.asarray(cv2.blur(cv2.dilate(picture, np.ones((edge, edge), np.uint8)), (3, 3)), np.float32)


def _project(bank: ViewBank, maps: DistanceMaps, view: int, points: Point3f) -> tuple[Vector2f, Float, Bool]:
    """Project points into a view.

    Return pixel coordinates, image scale in px/mm, and whether the view's distance map shows each point.
    """
    p = projection.project(bank, dr.opaque(mi.UInt32, view, dr.width(points)), points, mi.Bool(True))
    (width, height), place = (dr.opaque(mi.Float, count) for count in maps.samples_wh), maps.sample(p.px)
    visible = p.visible & (place.x >= -0.5) & (place.x < width - 0.5) & (place.y >= -0.5) & (place.y < height - 0.5)
    scale = dr.sqrt(dr.norm(p.du) * dr.norm(p.dv))
    dr.eval(p.px, scale, visible)  # evaluated together, so that points are projected only once
    return p.px, scale, visible
