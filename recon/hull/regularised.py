"""Regularised visual hull: mend what carving cut (Zheng et al. 2011, Int. Conference on Computer Vision, page 2026).

Where cameras are off by a pixel, an AND over all views removes thin roots. The remedy has two steps: every pixel of one
picture's silhouette gets a voxel on its line of sight, the one to which the other views object least; and separate
parts are joined along the cells to which the views object least. Only cells near the hull are looked at, those of the
hull of silhouettes that are grown by some pixels, as the thesis proposes (T5.3).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

from rhizotwin.recon.coverage.silhouettes import Silhouette
from rhizotwin.recon.hull import agreement
from rhizotwin.recon.hull.boxes import Scattered
from rhizotwin.recon.hull.leaves import Hull, Leaves, even
from rhizotwin.recon.optics.projection import ViewBank

Array = NDArray[np.float64]

_STEP = 1e-3
"""Objection of a view that a step through space counts as: of equally good ways the shortest is taken."""
_INSIDE = 1e-9
"""Cost of a step within the hull; zero would be no edge of the graph."""


def regularise(bank: ViewBank, silhouettes: Sequence[Silhouette], hull: Hull) -> Leaves:
    """Return the hull with the cells that one silhouette and connectedness need.

    Parameters
    ----------
    bank : ViewBank
        The views.
    silhouettes : (V,) sequence of Silhouette
        Of the same views.
    hull : Hull
        Carved with a slack: its leaves whose centre lies outside of a silhouette are the cells that may be added.

    Returns
    -------
    Leaves
        What is added is occupied wholly.
    """
    inside = hull.leaves.occupancy >= 0.5
    kept, free = hull.leaves.some(inside), hull.leaves.some(~inside)
    if not len(kept.size) or not len(free.size):
        return kept
    reference = int(np.argmax([float(one.coverage[one.seen].sum(dtype=np.float64)) for one in silhouettes]))
    edge_mm = free.grid.size_mm * free.size.astype(np.float64)
    objection = agreement.compare(bank, silhouettes, free.middles_mm, edge_mm).excluded.mean(axis=0)
    objection += 1.0 - 0.5 * (free.occupancy + hull.outer[~inside])  # of equally many views, how far the strictest objects
    added = _cover(bank.chosen([reference]), silhouettes[reference], kept, free, objection)
    added |= _connect(kept, free, objection, added)
    index, size = np.concatenate([kept.index, free.index[added]]), np.concatenate([kept.size, free.size[added]])
    return Leaves(kept.grid, index, size, np.concatenate([kept.occupancy, np.ones(int(added.sum()), np.float32)]))


def _cover(bank: ViewBank, silhouette: Silhouette, kept: Leaves, free: Leaves, objection: Array) -> NDArray[np.bool_]:
    """Return which free cells (N,) are the best before a pixel of the only view's silhouette that nothing covers."""
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
    """Return which free cells (N,) join the parts of the kept and added ones to the largest.

    Every part is one node of a graph, every other free cell another; the ways are shortest ones from the largest part.
    """
    solid = np.concatenate([even(kept.index, kept.size), free.index[added]])
    part = Scattered.of(solid).parts()
    sizes = np.bincount(part)
    rest = np.flatnonzero(~added)
    node = np.concatenate([part, len(sizes) + np.arange(len(rest))]).astype(np.int32)
    cost = np.concatenate([np.full(len(sizes), _INSIDE), _STEP + objection[rest]])
    ends = [[node[there] for there in pair] for _, *pair in Scattered.of(np.concatenate([solid, free.index[rest]])).neighbours()]
    here, there = (np.concatenate(side) for side in zip(*ends, strict=True))
    some = here != there
    here, there = np.concatenate([here[some], there[some]]), np.concatenate([there[some], here[some]])
    there = there[np.argsort(here, kind="stable")]
    begin = np.concatenate([[0], np.cumsum(np.bincount(here, minlength=len(cost)))])
    # by hand: a matrix made from pairs would add up the edges between two nodes, of which there may be many
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
