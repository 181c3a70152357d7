"""Taproot and hypocotyl among the tubes.

Which of a tree's nodes they are, and the spheres of the trimmed hull that give their radii and axes.
"""

from __future__ import annotations

import cv2
import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.ndimage import gaussian_filter1d
from scipy.spatial import cKDTree

from rhizotwin.recon.coverage.evidence import Evidence
from rhizotwin.recon.device import readable, vectors
from rhizotwin.recon.hull.boxes import Scattered
from rhizotwin.recon.hull.spheres import Spheres, depth_in_spheres
from rhizotwin.recon.optics import projection
from rhizotwin.recon.roots import tracing
from rhizotwin.recon.roots.density import Cells
from rhizotwin.recon.tubes import tubes
from rhizotwin.recon.tubes.tubes import SPACING_MM, Tubes

Mask = NDArray[np.bool_]

LEAST_PX = 3.0
"""Roots of a larger radius are organs that the hull measures: taproot, hypocotyl, storage roots."""
_TO_CORNER = 3.0**0.5
"""A solid's corner lies so many radii of its largest sphere from its centre, at most: that of a cube."""
_GAP_NODES = 3
"""Gaps of fewer nodes do not end an organ."""
_TANGENT_NODES = 3
"""An organ's direction is that of its spheres, smoothed over so many nodes."""


def thick(core: Cells, spheres: Spheres, least_mm: float) -> Cells:
    """Return the cells of a core about spheres of at least some radius: what is thinner is a tube, or a crowd of them.

    A part of the core as deep as that about which no sphere stands is no root, and stays whole: few views bound the
    spheres in a box.
    """
    if not len(core.index):
        return core
    large = spheres.radius_mm >= least_mm
    kept = depth_in_spheres(Spheres(spheres.centre_mm[large], _TO_CORNER * spheres.radius_mm[large]), core.centre_mm) > 0.0
    part = Scattered.of(core.index).parts()
    alone = np.flatnonzero(~np.isin(part, part[kept]))
    others = core.chosen(alone)
    kept[alone] = np.isin(part[alone], part[alone][tracing.core_depth(others, others.index, reach_mm=core.grid.size_mm) > least_mm])
    return core.chosen(kept)


def footprint(evidence: Evidence, core: Cells, margin_px: float) -> NDArray[np.bool_]:
    """Tell where (V, H, W) taproot and hypocotyl lie in all pictures: what a picture shows there is explained by them.

    Parameters
    ----------
    margin_px : float
        Within this of a core lies the whole of an organ.
    """
    (width, height), views = evidence.image_wh, evidence.bank.count
    covered = np.zeros((views, height, width), bool)
    rim = core.chosen(Scattered.of(core.index).faces()[0])  # it hides the others
    points = vectors(rim.centre_mm)
    for view in range(views if len(rim.index) else 0):
        p = projection.project(evidence.bank, dr.opaque(mi.UInt32, view, len(rim.index)), points, mi.Bool(True))
        lane = dr.compress(p.seen & readable(p.px, width, height))
        if dr.width(lane):
            column, row = mi.UInt32(p.px.x + 0.5), mi.UInt32(p.px.y + 0.5)
            empty = dr.full(mi.Float, 1.0, width * height)
            dr.scatter(empty, mi.Float(0.0), dr.gather(mi.UInt32, row * width + column, lane))
            away = cv2.distanceTransform(np.array(empty).reshape(height, width).astype(np.uint8), cv2.DIST_L2, 5)
            covered[view] = away <= margin_px
    return covered


def thicken(start: Tubes, core: Cells, spheres: Spheres, near_mm: float) -> tuple[Tubes, Mask, Mask]:
    """Give the nodes of taproot and hypocotyl the radius of the nearest sphere.

    A branch that runs within the core for more than the organ's width is the organ itself; others only begin inside it.

    Parameters
    ----------
    start : Tubes
        As traced.
    core, spheres : Cells, Spheres
        Cells deep inside full coverage, and the largest spheres there.
    near_mm : float
        Within this of a core lies the whole organ.

    Returns
    -------
    tubes : Tubes
        With the organs' radii.
    buried : (N,) bool array
        Nodes inside taproot and hypocotyl.
    organ : (N,) bool array
        Those of them that belong to the organ's own centre line.
    """
    none = np.zeros(len(start.radius_mm), bool)
    if not len(core.index) or not len(spheres.radius_mm):
        return start, none, none
    buried: Mask = core.tree.query(start.centre_mm)[0] < near_mm
    away, nearest = cKDTree(spheres.centre_mm).query(start.centre_mm)
    radius, organ = spheres.radius_mm[nearest], none.copy()
    width = np.where(away < radius + near_mm, 2.0 * radius, np.inf)  # what lies in no sphere is no root
    for k in range(len(start.branches)):
        own = start.own(k)
        run, count = ndimage.label(buried[own] | ndimage.binary_closing(buried[own], np.ones(_GAP_NODES, bool)))
        for number in range(1, count + 1):
            nodes = own[run == number]
            organ[nodes] = len(nodes) * SPACING_MM > float(np.median(width[nodes]))
    return tubes.moved(start, start.centre_mm, np.where(organ, radius, start.radius_mm)), buried, organ


def centred(start: Tubes, core: Cells, spheres: Spheres, near_mm: float) -> tuple[Tubes, Mask, Mask]:
    """Give the nodes of taproot and hypocotyl the radius of the nearest sphere, and its centre sideways of the organ.

    Where some pictures end at an organ, at the rim of sight, its core is torn, and the path through it strays towards
    the flank.

    Parameters
    ----------
    start : Tubes
        As traced.
    core : Cells
        Of organs only, as from `thick`.
    spheres : Spheres
        The largest in the core.
    near_mm : float
        Within this of a core lies the whole organ.

    Returns
    -------
    Tubes, (N,) bool array, (N,) bool array
        As from `thicken`.
    """
    wide, buried, organ = thicken(start, core, spheres, near_mm)
    if not organ.any():
        return wide, buried, organ
    centre = wide.centre_mm.copy()
    for k in range(len(wide.branches)):
        run, count = ndimage.label(organ[wide.own(k)])
        for number in range(1, count + 1):
            nodes = wide.own(k)[run == number]
            if len(nodes) < 2:
                continue
            sphere = spheres.centre_mm[cKDTree(spheres.centre_mm).query(centre[nodes])[1]]
            # beyond the last sphere, in a round tip, the nearest sphere stays the same: the line's own direction counts
            line = gaussian_filter1d(centre[nodes], _TANGENT_NODES, axis=0, mode="nearest")
            tangent = np.gradient(line, axis=0)
            tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-9)
            off = sphere - centre[nodes]
            centre[nodes] += gaussian_filter1d(off - (off * tangent).sum(axis=1, keepdims=True) * tangent, 1.0, axis=0, mode="nearest")
    return tubes.moved(wide, centre, wide.radius_mm), buried, organ


def in_solids(tree: Tubes, core: Cells, organ: Mask, margin_mm: float) -> Mask:
    """Tell the nodes (N,) in and about cores that bear no organ: spheres, boxes and bulbs, which no root explains.

    Parameters
    ----------
    core : Cells
        Of organs and solids, as from `thick`.
    organ : (N,) bool array
        As from `thicken`.
    margin_mm : float
        Within this of a core's cells lies the whole of a solid.
    """
    if not len(core.index):
        return np.zeros(len(organ), bool)
    away, nearest = core.tree.query(tree.centre_mm)
    part = Scattered.of(core.index).parts()[nearest]
    return (away < margin_mm) & ~np.isin(part, part[organ])
