"""Thick organs among the tubes: which of a tree's nodes they are, and the balls of the trimmed hull that give their radii and axes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.ndimage import gaussian_filter1d
from scipy.spatial import cKDTree

from rhizotwin.recon.hull.parsimony import Balls
from rhizotwin.recon.roots.density import Cells
from rhizotwin.recon.tubes import tubes
from rhizotwin.recon.tubes.tubes import SPACING_MM, Tubes

Mask = NDArray[np.bool_]

LEAST_PX = 3.0
"""Roots of a larger radius are thick organs."""
_GAP_NODES = 3
"""Gaps of fewer nodes do not end an organ."""
_COURSE_NODES = 3
"""An organ's direction is that of its balls, smoothed over so many nodes."""


def thick(core: Cells, balls: Balls, least_mm: float) -> Cells:
    """Return the cells of a core that lie inside balls of at least some radius: what is thinner is a tube, or a crowd of them."""
    large = balls.radius_mm >= least_mm
    near = cKDTree(core.centre_mm).query_ball_point(balls.centre_mm[large], balls.radius_mm[large]) if len(core.index) else []
    return core.chosen(np.unique(np.concatenate([np.zeros(0, np.int64), *(np.array(those, np.int64) for those in near)])))


def thicken(start: Tubes, core: Cells, balls: Balls, near_mm: float) -> tuple[Tubes, Mask, Mask]:
    """Give the nodes of thick organs the radius of the nearest ball.

    A branch that runs within the core for more than the organ's width is the organ itself; others only begin inside it.

    Returns
    -------
    tubes : with the organs' radii.
    buried : (N,) nodes inside thick organs.
    organ : (N,) those of them that belong to the organ's own centre line.
    """
    none = np.zeros(len(start.radius_mm), bool)
    if not len(core.index) or not len(balls.radius_mm):
        return start, none, none
    buried: Mask = cKDTree(core.centre_mm).query(start.centre_mm)[0] < near_mm
    radius, organ = balls.radius_mm[cKDTree(balls.centre_mm).query(start.centre_mm)[1]], none.copy()
    for k in range(len(start.branches)):
        own = start.own(k)
        run, count = ndimage.label(buried[own] | ndimage.binary_closing(buried[own], np.ones(_GAP_NODES, bool)))
        for number in range(1, count + 1):
            nodes = own[run == number]
            organ[nodes] = len(nodes) * SPACING_MM > 2.0 * float(np.median(radius[nodes]))
    return tubes.moved(start, start.centre_mm, np.where(organ, radius, start.radius_mm)), buried, organ


def centred(start: Tubes, core: Cells, balls: Balls, near_mm: float) -> tuple[Tubes, Mask, Mask]:
    """Give the nodes of thick organs the radius of the nearest ball, and its centre sideways of the organ.

    Where some pictures end at an organ, at the rim of sight, its core is torn, and the path through it strays towards the flank.

    Parameters
    ----------
    core : of organs only, as from `thick`.

    Returns
    -------
    As from `thicken`.
    """
    wide, buried, organ = thicken(start, core, balls, near_mm)
    if not organ.any():
        return wide, buried, organ
    centre = wide.centre_mm.copy()
    for k in range(len(wide.branches)):
        run, count = ndimage.label(organ[wide.own(k)])
        for number in range(1, count + 1):
            nodes = wide.own(k)[run == number]
            if len(nodes) < 2:
                continue
            ball = balls.centre_mm[cKDTree(balls.centre_mm).query(centre[nodes])[1]]
            course = np.gradient(gaussian_filter1d(ball, _COURSE_NODES, axis=0, mode="nearest"), axis=0)
            course /= np.maximum(np.linalg.norm(course, axis=1, keepdims=True), 1e-9)
            off = ball - centre[nodes]
            centre[nodes] += gaussian_filter1d(off - (off * course).sum(axis=1, keepdims=True) * course, 1.0, axis=0, mode="nearest")
    return tubes.moved(wide, centre, wide.radius_mm), buried, organ
