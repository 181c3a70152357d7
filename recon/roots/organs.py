"""Thick roots and solids: initial radii of roots inside the core, and parts of the core that no root explains."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree

from rhizotwin.recon.coverage.evidence import CORE_PX, Evidence
from rhizotwin.recon.hull import agreement
from rhizotwin.recon.hull.boxes import CellSet
from rhizotwin.recon.roots.density import Cells
from rhizotwin.recon.tubes import tubes
from rhizotwin.recon.tubes.tubes import SPACING_MM, Tubes

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

THICK_PX = 3.0
"""Minimum radius of a thick root, px. Above this radius, every view resolves both edges of the root despite the
blur."""
_RIM_PX = CORE_PX + 0.5
"""Distance between the surface of a root and the surface of its core, px. It includes half a pixel at the surface of
the root, which is not fully covered."""
_GAP_NODES = 3
"""Minimum number of consecutive nodes outside the core for a thick root to be interrupted there."""


@dataclass(frozen=True)
class Core:
    """Cells that are projected deep inside the fully covered area in every view."""

    cells: Cells
    depth_mm: Array
    """Distance from each cell to the nearest cell outside the core, shape (N,), mm."""

    def select(self, which: Mask | NDArray[np.int64]) -> Core:
        """Return a subset of the cells, selected by a mask (N,) or indices (M,)."""
        return Core(self.cells.select(which), self.depth_mm[which])


def thicken(start: Tubes, core: Core, px_a_mm: float) -> tuple[Tubes, Mask]:
    """Set the radii of the nodes inside a core.

    The radius of a node is the largest radius of a section through it of a sphere in the core. A branch that runs
    inside the core for more than the width of these spheres is a thick root. Other branches merely begin inside a thick
    root.

    Parameters
    ----------
    start : Tubes
        Traced tubes.
    core : Core
        Core in which the tubes may run.
    px_a_mm : float
        Image scale at the centre of the water, px/mm.

    Returns
    -------
    tubes : Tubes
        Tubes with the radii of thick roots.
    thick : (N,) bool array
        Mask of the nodes of thick roots.
    """
    thick, radius = np.zeros(len(start.radius_mm), bool), start.radius_mm.copy()
    inner, section = _inner_radius(core, start.centre_mm, _RIM_PX / px_a_mm)
    for k in range(len(start.branches)):
        own = start.own(k)
        buried = inner[own] > 0.0
        run, count = ndimage.label(buried | ndimage.binary_closing(buried, np.ones(_GAP_NODES, bool)))
        for number in range(1, count + 1):
            nodes = own[run == number]
            at, inside = np.arange(len(nodes)), np.flatnonzero(inner[nodes] > 0.0)
            if len(nodes) * SPACING_MM > 2.0 * float(np.median(np.interp(at, inside, inner[nodes][inside]))):
                thick[nodes], radius[nodes] = True, np.interp(at, inside, section[nodes][inside])
    return tubes.with_geometry(start, start.centre_mm, radius), thick


def _inner_radius(core: Core, points_mm: Array, rim_mm: float) -> tuple[Array, Array]:
    """Return two radii for each point (N, 3), mm: of spheres in a core that contain it, and of their sections at it.

    The spheres extend beyond the core by ``rim_mm``. A section is perpendicular to the line from the sphere's centre to
    the point, like the section of a ball at a point of its axis. Both radii (N,) are the largest ones. They are 0 at
    points outside the core.
    """
    found, section = np.zeros(len(points_mm)), np.zeros(len(points_mm))
    depth, edge_mm = core.depth_mm, core.cells.grid.size_mm
    if not len(depth):
        return found, section
    highest = depth.copy()  # maximum depth around each cell
    for _, here, there in CellSet.from_cells(core.cells.index).neighbours():
        np.maximum.at(highest, here, depth[there])
        np.maximum.at(highest, there, depth[here])
    ridge = np.flatnonzero(depth > highest - 0.6 * edge_mm)  # also for a cone, whose depth rises by less per cell
    octave, place = np.floor(np.log2(depth[ridge] / edge_mm)), cKDTree(points_mm)
    for one in np.unique(octave):  # groups of similar size limit the search
        some = core.select(ridge[octave == one])
        near = place.sparse_distance_matrix(cKDTree(some.cells.centre_mm), float(some.depth_mm.max()), output_type="ndarray")
        size = some.depth_mm[near["j"]]
        inside = near["v"] < size
        radius = size[inside] - 0.5 * edge_mm + rim_mm
        np.maximum.at(found, near["i"][inside], radius)
        np.maximum.at(section, near["i"][inside], np.sqrt(np.maximum(radius**2 - near["v"][inside] ** 2, 0.0)))
    return found, section


def find_solids(core: Core, tree: Tubes, thick: Mask, px_a_mm: float) -> Cells:
    """Return the parts of a core that contain no thick root, such as balls, boxes and bulbs.

    Parts narrower than a thick root are clusters of thin roots and are not returned.

    Parameters
    ----------
    thick : (N,) bool array
        Mask of the nodes of thick roots, as returned by `thicken`.
    """
    if not len(core.depth_mm):
        return core.cells
    part = CellSet.from_cells(core.cells.index).components()
    deep = part[core.depth_mm > (THICK_PX - _RIM_PX) / px_a_mm]
    taken = part[core.cells.tree.query(tree.centre_mm[thick])[1]] if thick.any() else part[:0]
    return core.cells.select(np.isin(part, deep) & ~np.isin(part, taken))


def footprint(evidence: Evidence, solids: Cells, margin_px: float) -> NDArray[np.bool_]:
    """Return the mask (V, H, W) of pixels that are covered by solids.

    Parameters
    ----------
    margin_px : float
        Margin around the core within which the whole solid lies, px.
    """
    (width, height), rim = evidence.image_wh, solids.select(CellSet.from_cells(solids.index).faces()[0])  # hides all inner cells
    points, none, views = rim.centre_mm, np.zeros(len(rim.index)), range(evidence.bank.count)
    return np.array([agreement.distance_px(evidence.bank.select([view]), points, none, (height, width)) <= margin_px for view in views])


def find_solid_nodes(tree: Tubes, solids: Cells, margin_mm: float) -> Mask:
    """Return the mask (N,) of nodes inside or next to solids.

    Parameters
    ----------
    margin_mm : float
        Margin around the cells of the core within which the whole solid lies, mm.
    """
    if not len(solids.index):
        return np.zeros(len(tree.radius_mm), bool)
    return np.asarray(solids.tree.query(tree.centre_mm)[0] < margin_mm)


def is_thick(tree: Tubes, px_a_mm: float) -> Mask:
    """Return the mask (N,) of the nodes of thick roots."""
    return np.asarray(tree.radius_mm > THICK_PX / px_a_mm)
