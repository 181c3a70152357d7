"""Smoothness prior of branches, and the motion of their flanks with their nodes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from rhizotwin.recon.tubes.tubes import Tubes

Array = NDArray[np.float64]

_BEND = 2.0
"""Weight of the squared second differences of node positions in the smoothness prior, 1/mm2. For comparison, the
profile of a fully visible node in one view has a weight of about 10/mm2."""
_SUPPLE_MM = 0.34
"""Radius of a root for which the weight of the bending is twice `_BEND`, mm.

With a constant weight, nodes of a wide tube would follow irregularities of its flanks over distances shorter than its
radius. The weight therefore increases with the fourth power of the radius, like the stiffness of a beam. Nodes with
data of 1600/mm2 (80 views of 4 px/mm) are smoothed over a third of their radius."""
_TAPER = 12.0
"""Weight of the squared relative differences between the radii of adjacent nodes in the smoothness prior. It makes the
radius nearly constant over more than a centimetre.

With a smaller weight, roots in dense clusters became alternately thick and thin from node to node, and too thick on
average, since the radius of a hidden root has no lower bound."""
_STRETCH_NODES = 21
"""Number of nodes over which a root has approximately the same thickness: 12.6 mm at a spacing of 0.6 mm."""


def flank_motion(tubes: Tubes) -> sparse.csr_matrix:
    """Return the matrix (4 N, 4 N) that converts displacements of nodes to those of the flanks beside them.

    If a branch turns, the flanks beside a node also move along the branch. Where the radius r changes along the branch,
    this displaces them sideways by r dr/ds times the angle, s being the distance along the branch. The centre line of a
    ball can therefore turn about its middle without any change in the pictures.

    Returns
    -------
    (4 N, 4 N) csr_matrix
        Each node has three coordinates and a radius, mm; radii are not affected.
    """
    count, neighbours = len(tubes.radius_mm), tubes.neighbours
    beside = tubes.radius_mm[neighbours]
    child = np.array([nodes[1] for nodes in tubes.branches[1:]], np.int64)
    beside[child, 0] = tubes.radius_mm[child]  # the first node of a branch has its parent's radius
    chord = np.maximum(np.linalg.norm(np.diff(tubes.centre_mm[neighbours], axis=1)[:, 0], axis=1), 1e-9)
    slope = np.clip(np.diff(beside, axis=1)[:, 0] / chord, -1.0, 1.0)  # steeper flanks are inside a neighbouring sphere
    aside = sparse.diags(tubes.radius_mm * slope / chord) @ _differences(neighbours, np.array([-1.0, 1.0]), count)
    return (sparse.identity(4 * count) + sparse.kron(aside, sparse.diags([1.0, 1.0, 1.0, 0.0]))).tocsr()


def median_radii(tubes: Tubes) -> Array:
    """Return the median radius (N,) of the surrounding nodes on the same branch, mm."""
    line, first, last = tubes.flattened
    first = first + (first > 0)  # the first node of a branch has its parent's radius
    own = np.arange(len(line))
    own = own[own >= first]
    stretch = own[:, None] + np.arange(_STRETCH_NODES) - _STRETCH_NODES // 2
    typical = tubes.radius_mm.copy()
    typical[line[own]] = np.median(tubes.radius_mm[line[np.clip(stretch, first[own][:, None], last[own][:, None])]], axis=1)
    return typical


def prior(tubes: Tubes) -> sparse.csr_matrix:
    """Return the quadratic form (4 N, 4 N) of the smoothness prior.

    The prior penalises bending, and changes of the radius within a branch. Changes of the radius are relative to the
    typical radius of the surrounding nodes, so that a taproot may taper by the same fraction of its width as a lateral.
    """
    count = len(tubes.radius_mm)
    line, first, last = tubes.flattened
    place = np.arange(len(line))
    middle = np.flatnonzero((first < place) & (place < last))
    triples = np.stack([line[middle - 1], line[middle], line[middle + 1]], axis=1)
    second = np.flatnonzero(place > first + (first > 0))  # the first node of a branch has its parent's radius
    neighbours = np.stack([line[second - 1], line[second]], axis=1)
    bend = _differences(triples, np.array([1.0, -2.0, 1.0]), count)
    beam = (tubes.radius_mm[triples].min(axis=1) / _SUPPLE_MM) ** 4
    beam[(middle == first[middle] + 1) & (first[middle] > 0)] = 0.0  # a branch is hinged to its parent
    stiff = sparse.diags(_BEND * (1.0 + beam))
    taper = _differences(neighbours, np.array([-1.0, 1.0]), count)
    typical = median_radii(tubes)
    taper = sparse.diags(typical[neighbours].prod(axis=1) ** -0.5) @ taper
    position, radius = sparse.diags([1.0, 1.0, 1.0, 0.0]), sparse.diags([0.0, 0.0, 0.0, 1.0])
    return (sparse.kron(bend.T @ stiff @ bend, position) + sparse.kron(_TAPER * taper.T @ taper, radius)).tocsr()


def _differences(nodes: NDArray[np.int64], weights: Array, count: int) -> sparse.csr_matrix:
    """Return a sparse matrix (R, N) that computes weighted sums of nodes.

    Row r adds the nodes in row r of ``nodes``, multiplied by ``weights``. N is ``count``.
    """
    rows = np.repeat(np.arange(len(nodes)), nodes.shape[1])
    return sparse.coo_matrix((np.tile(weights, len(nodes)), (rows, nodes.ravel())), shape=(len(nodes), count)).tocsr()
