"""Search for missing roots: tracing of the coverage that the tubes leave unexplained, and attachment of new branches.

A pixel with measured coverage m and explained coverage e = 1 - exp(-t) contains evidence of another root

    d = m - e = u c,    u = exp(-t)

where u is the fraction of the pixel that the tubes leave free and c is the coverage of the other root. The
least-squares estimate of c at a point of the search space, over all views, is sum(u d) / sum(u^2). Views in which the
point is hidden have no weight, and the estimate is small for a point that is empty in some views. The estimate requires
no iteration, and it finds short laterals beside thick roots, which the density stage does not separate from their
parents.

A root at the point would explain the fraction c sum(u d) / sum(d^2) of the squared residual. In a dense root system,
most points at which c is large are ghosts, and this fraction is low. New roots end only at points with the fraction
that is required of the nodes of a root (`ghosts.EXPLAINED`). Without this condition, 20,000 branches were added to a
radish of 30 days, all but 400 of which were removed after the next fit.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.coverage.evidence import Evidence
from rhizotwin.recon.device import Float, UInt32, bilinear, points, readable
from rhizotwin.recon.lattice import cells as lattices
from rhizotwin.recon.lattice.cells import Lattice
from rhizotwin.recon.optics import projection
from rhizotwin.recon.roots import ghosts, tracing
from rhizotwin.recon.roots.density import Cells
from rhizotwin.recon.tubes import tubes
from rhizotwin.recon.tubes.translucent_tube import equivalent_radius
from rhizotwin.recon.tubes.tubes import Tubes

Array = NDArray[np.float64]

_SURE = 0.25
"""Minimum residual coverage for a cell to be part of a missing root. It corresponds to a root that is a third of a
pixel wide."""
_OWN_CELLS = 0.9
"""Minimum distance from a centre line within which cells belong to the root, in cell edges. It applies if the radius of
the root is smaller. Half the diagonal of a cell is 0.87 edges."""
_LEAST_VIEWS = 4.0
"""Minimum sum of the weights over all views for the residual coverage of a point to be estimated. The weight of a view
is u^2, where u is the fraction of the pixel that the tubes leave free."""
_THINNEST_MM = 0.05
"""Minimum radius of a new root, mm."""
_LEAST_MM = 0.4
"""Minimum length of a new branch outside the existing tubes, mm."""
_BEGIN_MM = 1.0
"""Length that is added to a path that begins on the side of a root and not at its tip, mm. With this addition,
extending a root costs less than beginning a new branch."""
_TIP_MM = 0.4
"""Maximum distance between the beginning of a new branch and the tip of a root, mm, for the branch to be an extension
of that root."""


def residual_coverage(evidence: Evidence, points_mm: Array, free: Float) -> tuple[Array, Array]:
    """Estimate the residual coverage (N,) at points (N, 3) from all views.

    Return the coverage, which is 0 at points for which too few views contribute, and the fraction (N,) of the squared
    residual that a root with this coverage would explain.

    Parameters
    ----------
    free : Float
        Transmittance of the tubes in all views (`recon.tubes.tube_picture.transmittance`).
    """
    left = mi.Float16((evidence.opacity - (1.0 - free)) * evidence.usable)
    dr.eval(left)
    (width, height), point = evidence.size, points(points_mm)

    def body(view: UInt32, top: Float, weight: Float, square: Float) -> tuple[UInt32, Float, Float, Float]:
        p = projection.project(evidence.bank, view, point, mi.Bool(True))
        visible = p.visible & readable(p.px, width, height)
        px, base = dr.select(visible, p.px, mi.Vector2f(0.0)), view * (width * height)
        usable = bilinear(evidence.usable, base, width, px.x, px.y, visible)
        good = visible & (usable > 0.99)
        u, d = (dr.select(good, bilinear(source, base, width, px.x, px.y, visible), 0.0) for source in (free, left))
        return view + 1, top + u * d, weight + dr.square(u), square + dr.square(d)

    state = dr.zeros(mi.UInt32, len(points_mm)), *(dr.zeros(mi.Float, len(points_mm)) for _ in range(3))
    sums = dr.while_loop(state, lambda view, *_: view < evidence.bank.end, body)[1:]
    dr.eval(sums)  # evaluated together, to project once
    top, weight, square = (np.array(total) for total in sums)
    coverage = np.where(weight > _LEAST_VIEWS, top / np.maximum(weight, 1e-6), 0.0)
    return coverage, coverage * top / np.maximum(square, 1e-6)


def add_missing_roots(evidence: Evidence, found: Tubes, thick: NDArray[np.bool_], cells: Cells, free: Float, px_a_mm: float) -> Tubes:
    """Trace missing roots in the coverage that the tubes of a tree do not explain, and add them to the tree.

    Parameters
    ----------
    thick : (N,) bool array
        Mask of the nodes of thick roots.
    cells : Cells
        Cells of the search space, excluding solids.
    px_a_mm : float
        Image scale at the centre of the water, px/mm.
    """
    line, radius, node = _sample_tubes(found, 0.5 * cells.grid.size_mm)
    flanked = ghosts.find_margin_nodes(found, thick)
    reach = np.maximum(radius, _OWN_CELLS * cells.grid.size_mm) + np.where(flanked[node], ghosts.FLANK_PX / px_a_mm, 0.0)
    cells = cells.select(lattices.sort(cells.index))
    size_mm = cells.grid.size_mm
    furthest = np.full(len(line), reach.max() / size_mm)
    away, nearest = lattices.find_nearest(Lattice.of(cells.index), cells.place(line), furthest)
    inside = away * size_mm < reach[nearest]  # the distance is infinite where no node is near
    # Few views resolve the flank of a thick root, so that no branch may begin there.
    beside = ~(inside & thick[node[nearest]])
    cells, nearest, inside = cells.select(beside), nearest[beside], inside[beside]
    lattice, centre = Lattice.of(cells.index), cells.centre_mm
    own, explained = np.zeros(len(inside)), np.zeros(len(inside))
    own[~inside], explained[~inside] = residual_coverage(evidence, centre[~inside], free)
    sure = (own > _SURE) & (explained > ghosts.EXPLAINED)
    if not sure.any() or not inside.any():
        return found
    ends = np.array([nodes[-1] for nodes in found.branches])
    _, tip = lattices.find_nearest(lattice, cells.place(found.centre_mm[ends]), np.full(len(ends), _TIP_MM / size_mm))
    # Half a step inside a tube costs as much as the extra length of a branch on its flank, but nothing at a tip.
    flank = 0.5 * size_mm / _BEGIN_MM * _SURE * px_a_mm
    density = np.where(inside, np.where(tip >= 0, 1e3, flank), np.maximum(own, 0.0) * px_a_mm)
    claim = tracing.CLAIM_CELLS + 0.5 * own / px_a_mm / size_mm  # a wider root covers more around its centre line
    ways = tracing.find_paths(lattice, density, np.flatnonzero(inside))
    lines = tracing.branches(lattice, ways, sure, claim, _LEAST_MM / size_mm)
    paths, radii, parents = [], [], []
    for way in lines:
        opaque = np.maximum(0.5 * own[way] / px_a_mm, _THINNEST_MM)
        wide = equivalent_radius(opaque, evidence.light)
        paths.append(centre[way])
        radii.append(np.full(len(way), float(np.median(wide[1:]))))
        begin = way[0]
        parents.append(int(ends[tip[begin]] if tip[begin] >= 0 else node[nearest[begin]]) if inside[begin] else -1)
    return tubes.attach(found, paths, radii, parents)


def _sample_tubes(found: Tubes, step_mm: float) -> tuple[Array, Array, NDArray[np.int64]]:
    """Sample points (P, 3) along the tubes.

    Return the points, the tube radius at each point (P,), and the index of the node nearest to each point (P,).
    """
    a, b = found.segments.T
    count = np.maximum(np.ceil(np.linalg.norm(found.centre_mm[b] - found.centre_mm[a], axis=1) / step_mm), 1).astype(np.int64)
    segment = np.repeat(np.arange(len(a)), count)
    share = (np.arange(len(segment)) - np.repeat(np.cumsum(count) - count, count) + 0.5) / count[segment]
    first, second = a[segment], b[segment]
    # The first node of a branch has its parent's radius.
    radius = np.minimum(found.radius_mm[first], found.radius_mm[second])
    return (
        found.centre_mm[first] + share[:, None] * (found.centre_mm[second] - found.centre_mm[first]),
        radius,
        np.where(share < 0.5, first, second),
    )
