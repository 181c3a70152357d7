"""Regularised visual hull: restoration of parts lost in carving (Zheng et al. 2011, ICCV, page 2026).

With camera errors of about one pixel, the intersection of all views loses thin roots. They are restored in two steps.
First, for each uncovered pixel of one reference silhouette, the cell on its line of sight that the fewest other views
exclude is added. Second, separate components are joined along paths of the cells that the fewest views exclude. Only
cells near the hull are candidates: those inside the hull of silhouettes dilated by a few pixels, as proposed in the
thesis (T5.3).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

from rhizotwin.recon.coverage.silhouettes import Silhouette
from rhizotwin.recon.hull import agreement
from rhizotwin.recon.hull.boxes import CellSet
from rhizotwin.recon.hull.leaves import Hull, Leaves
from rhizotwin.recon.optics.projection import ViewBank

Array = NDArray[np.float64]

_STEP = 1e-3
"""Cost of each cell on a path outside the hull, in addition to the fraction of views that exclude the cell. It ensures
that the shortest of several equally good paths is selected."""
_INSIDE = 1e-9
"""Cost at which a path enters a component of the hull. It is not zero, since an edge without a cost would be missing
from the sparse graph."""


def regularise(bank: ViewBank, silhouettes: Sequence[Silhouette], hull: Hull) -> Leaves:
    """Add cells to a hull, so that it explains the reference silhouette and forms a single connected component.

    Parameters
    ----------
    bank : ViewBank
        Views.
    silhouettes : (V,) sequence of Silhouette
        Silhouettes of the same views.
    hull : Hull
        Hull carved with a tolerance. Leaves whose centre lies outside a silhouette are candidates.

    Returns
    -------
    Leaves
        Regularised hull. Added leaves are fully occupied.
    """
    inside = hull.leaves.occupancy >= 0.5
    kept, free = hull.leaves.select(inside), hull.leaves.select(~inside)
    if not len(kept.size) or not len(free.size):
        return kept
    reference = int(np.argmax([float(one.coverage[one.usable].sum(dtype=np.float64)) for one in silhouettes]))
    edge_mm = free.grid.size_mm * free.size.astype(np.float64)
    objection = agreement.compare(bank, silhouettes, free.middles_mm, edge_mm).excluded.mean(axis=0)
    objection += 1.0 - 0.5 * (free.occupancy + hull.outer[~inside])  # of cells excluded by equally many views, the nearest to the outline
    added = _cover(bank.select([reference]), silhouettes[reference], kept, free, objection)
    added |= _connect(kept, free, objection, added)
    index, size = np.concatenate([kept.index, free.index[added]]), np.concatenate([kept.size, free.size[added]])
    return Leaves(kept.grid, index, size, np.concatenate([kept.occupancy, np.ones(int(added.sum()), np.float32)]))


def _cover(bank: ViewBank, silhouette: Silhouette, kept: Leaves, free: Leaves, objection: Array) -> NDArray[np.bool_]:
    """Return the mask (N,) of candidate cells that are added to explain the reference silhouette.

    For each pixel of the silhouette onto which the hull does not project, the candidate that the fewest views exclude
    is selected among those that project onto this pixel.
    """
    size_mm = kept.grid.size_mm
    missed = agreement.missed_pixels(bank, silhouette, kept.middles_mm, size_mm * kept.size.astype(np.float64))
    pixel, inside = agreement.pixels(bank, free.middles_mm, silhouette.coverage.shape)
    candidates = np.flatnonzero(inside)[missed.ravel()[pixel[inside]]]
    by_pixel = candidates[np.lexsort((objection[candidates], pixel[candidates]))]
    first = np.append(True, np.diff(pixel[by_pixel]) > 0)[: len(by_pixel)]
    best = np.zeros(len(free.size), bool)
    best[by_pixel[first]] = True
    return best


def _connect(kept: Leaves, free: Leaves, objection: Array, added: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the mask (N,) of candidate cells that join all components to the largest component.

    The components consist of the hull's cells and the cells already added. Each component is one node of a graph, and
    each remaining candidate cell is another. Shortest paths are computed from the largest component.
    """
    solid = np.concatenate([kept.split().index, free.index[added]])
    part = CellSet.from_cells(solid).components()
    sizes = np.bincount(part)
    rest = np.flatnonzero(~added)
    node = np.concatenate([part, len(sizes) + np.arange(len(rest))]).astype(np.int32)
    cost = np.concatenate([np.full(len(sizes), _INSIDE), _STEP + objection[rest]])
    ends = [[node[there] for there in pair] for _, *pair in CellSet.from_cells(np.concatenate([solid, free.index[rest]])).neighbours()]
    here, there = (np.concatenate(side) for side in zip(*ends, strict=True))
    some = here != there
    here, there = np.concatenate([here[some], there[some]]), np.concatenate([there[some], here[some]])
    there = there[np.argsort(here, kind="stable")]
    begin = np.concatenate([[0], np.cumsum(np.bincount(here, minlength=len(cost)))])
    # Built explicitly: a matrix made from pairs would sum multiple edges between two nodes.
    graph = csr_matrix((cost[there], there, begin.astype(np.int32)), shape=(len(cost),) * 2)
    before = dijkstra(graph, indices=int(sizes.argmax()), return_predecessors=True)[1]
    way = np.zeros(len(cost), bool)
    last = np.arange(len(sizes))
    while len(last):
        last = np.unique(before[last][before[last] >= 0])
        last = last[~way[last]]
        way[last] = True
    joined = np.zeros(len(free.size), bool)
    joined[rest[way[len(sizes) :]]] = True
    return joined
