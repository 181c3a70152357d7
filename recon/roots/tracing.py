"""Tracing of centre lines from the density: a tree of shortest paths to the top of the root system.

The cost of a path per millimetre decreases with the density. The shortest paths from all cells to the top (Dijkstra)
form a tree, from which branches are extracted as in TEASAR (Sato et al. 2000, Pacific Graphics). The path from the
farthest unclaimed cell to the first branch that it meets becomes a new branch, which claims the cells around it. This
is repeated until no dense cell is left. Gaps within the search space, and gaps hidden by the net pot, are bridged at a
cost.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from scipy.sparse import coo_matrix, csr_matrix
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from rhizotwin.recon.hull.boxes import CellSet
from rhizotwin.recon.roots import crown
from rhizotwin.recon.roots.density import Cells

Array = NDArray[np.float64]
Index = NDArray[np.int64]
T = TypeVar("T", bound=np.generic)

_SMOOTH_CELLS = 0.7
"""Standard deviation of the Gaussian that smooths the density, in cells. It suppresses noise in single cells."""
_CAP = 37.5
"""Upper limit of the density (shadow per volume, 1/mm). Higher values are not informative."""
_BRIDGE = 0.125
"""Density added to that of each cell in the cost of a path, 1/mm, so that paths can cross empty cells. For comparison,
a root of 0.3 mm has a density of about 2/mm."""
_DENSE = 0.25
"""Density above which a cell must be part of a branch, 1/mm."""
_IN_CORE, _BY_DEPTH = 10.0, 100.0
"""Density at the surface of taproot and hypocotyl, 1/mm, and its increase per millimetre of depth. The increase keeps
paths near the axis."""
CLAIM_CELLS = 1.5
"""Distance from a traced root within which cells are assigned to the root, in cell edges."""
_STILL_OPEN = 0.5
"""Minimum fraction of the cells in the k-d tree that are not yet assigned to a root. Below this fraction, the tree is
rebuilt without the assigned cells. With one half, each rebuild takes as long as all later rebuilds together."""
_CORE_CLAIM_MM = 0.65
"""Distance beyond the surface of the core within which cells are assigned to a path in the taproot or hypocotyl, mm."""
_LEAST_MM = 1.0
"""Minimum length of a traced root, mm."""
_TOP_MM, _RISE_MM = 1.0, 6.0
"""Height below the highest cell within which the top of a plant is searched, mm, and height above the visible stem up
to which laterals are ignored in this search, mm."""
_THIN_MM = (0.05, 0.3)
"""Lower and upper limit of the initial radii, which are derived from shadows, mm. In roots thicker than the upper
limit, cells shade each other, so that shadows do not indicate the radius."""


@dataclass(frozen=True)
class Path:
    """Points and shadows along a traced branch."""

    points_mm: Array
    """Points from the branch's parent to its tip, shape (N, 3), mm. The first point lies on the parent."""
    shadow_mm2: Array
    """Shadow area of the cells around each point, shape (N,), mm2."""


def core_depth(cells: Cells, core: NDArray[np.int32], *, reach_mm: float, most_mm: float = np.inf) -> Array:
    """Return the depth (N,) of cells inside a core, mm. Outside, it is the negative distance from the core.

    Parameters
    ----------
    cells : Cells
        Cells for which the depth is computed.
    core : (M, 3) int32 array
        Cells of the core, on the same lattice.
    reach_mm : float
        Upper limit of the distance outside the core, mm.
    most_mm : float
        Upper limit of the depth inside the core, mm.
    """
    depth = np.full(len(cells.index), -reach_mm)
    if not len(core):
        return depth
    full = CellSet.from_cells(core)
    rim, beyond = full.faces()  # only cells with a face in common with the other kind can be nearest
    inside, size_mm = full.contains(cells.index), cells.grid.size_mm
    deep = cKDTree(beyond).query(cells.index[inside], distance_upper_bound=most_mm / size_mm, workers=-1)[0]
    depth[inside] = np.minimum(deep * size_mm, most_mm)
    away = cKDTree(core[rim]).query(cells.index[~inside], distance_upper_bound=reach_mm / size_mm, workers=-1)[0]
    depth[~inside] = np.maximum(-away * size_mm, -reach_mm)
    return depth


def trace(cells: Cells, depth_mm: Array) -> list[Path]:
    """Trace branches in a field of root density.

    Parameters
    ----------
    cells : Cells
        Search space with shadows.
    depth_mm : (N,) float64 array
        Depth of the cells in the cores of taproot and hypocotyl, as returned by `core_depth`. Cells outside a core that
        are not at the minimum depth are part of the flank of taproot or hypocotyl and contain no tips.

    Returns
    -------
    list of Path
        Traced branches. Parents come before children. Empty if no cell is dense.
    """
    density, thin = _IN_CORE + _BY_DEPTH * depth_mm, depth_mm <= 0
    density[thin] = np.minimum(_smooth(cells.select(thin)), _CAP)  # cells of a core have no shadow
    dense = (density > _DENSE) & ((depth_mm > 0) | (depth_mm <= depth_mm.min()))
    if not dense.any():
        return []
    centre = cells.centre_mm
    joined = graph(cells, density)
    members = crown.find_top_cells(centre, dense, cells.tops_mm)
    if not members:
        # Use the top of the heaviest connected part, including the organs and the cells between them and their roots: a
        # fibre of the felt or a bubble may lie higher than the plant.
        body = (density > _DENSE) | (depth_mm > depth_mm.min())
        number, part = np.flatnonzero(body), CellSet.from_cells(cells.index[body]).components()
        plant = number[part == np.bincount(part, weights=cells.shadow_mm2[body]).argmax()]
        members = {-1: plant[dense[plant]]}
    starts = {top: _start(plant, centre, density, depth_mm) for top, plant in members.items()}
    bridges = _bridge_net_pot(cells, dense, np.array(list(starts.values())))
    joined = joined + bridges if bridges.nnz else joined  # the sum takes as much memory again
    cost, before, _ = dijkstra(joined, directed=False, indices=list(starts.values()), min_only=True, return_predecessors=True)
    length = lengths(cost, before, centre)
    claim = np.where(depth_mm > 0, depth_mm + _CORE_CLAIM_MM, CLAIM_CELLS * cells.grid.size_mm)
    lines = branches(centre, before, np.where(dense & np.isfinite(cost), length, -1.0), claim)
    if not lines:
        return []
    some = np.flatnonzero(cells.shadow_mm2)
    nearest = cKDTree(centre[np.concatenate(lines)]).query(centre[some], workers=-1)[1]
    total = np.bincount(nearest, weights=cells.shadow_mm2[some], minlength=sum(len(line) for line in lines)).astype(np.float64)
    shadows = np.split(total, np.cumsum([len(line) for line in lines])[:-1])
    paths = [Path(centre[line], shadow) for line, shadow in zip(lines, shadows, strict=True)]
    if not cells.tops_mm:
        return paths
    hung = [(int(line[0]), path.points_mm, path.shadow_mm2) for line, path in zip(lines, paths, strict=True)]
    under = {starts[top]: cells.tops_mm[top] for top in members if top >= 0}
    return [Path(*path) for path in crown.attach_paths(hung, under, cells.grid.size_mm)] if under else paths


def _bridge_net_pot(cells: Cells, dense: NDArray[np.bool_], starts: Index) -> csr_matrix:
    """Return the edges of the graph (N, N) that connect separate parts of the search space behind the net pot.

    Their cost per millimetre is that of empty cells. A part is connected to a plant if the distance of its dense cells
    from the plant's top does not exceed the maximum length of a hidden base.
    """
    centre, part = cells.centre_mm, CellSet.from_cells(cells.index).components()
    begun, top_mm = np.isin(part, part[starts]), centre[starts, 2].min()
    heads = np.flatnonzero(dense & begun & (centre[:, 2] > top_mm - _TOP_MM))
    high = np.flatnonzero(dense & ~begun & (centre[:, 2] > top_mm - crown.HIDDEN_MM))
    away, nearest = cKDTree(centre[heads]).query(centre[high], distance_upper_bound=crown.HIDDEN_MM)
    order = np.argsort(away, kind="stable")
    order = order[np.isfinite(away[order])]
    first = order[np.unique(part[high[order]], return_index=True)[1]]
    shape = (len(centre), len(centre))
    return coo_matrix(((away[first] / _BRIDGE).astype(np.float32), (heads[nearest[first]], high[first])), shape=shape).tocsr()


def _start(plant: Index, centre: Array, density: Array, depth_mm: Array) -> int:
    """Return the cell at a plant's top from which its roots are traced.

    It is the middle one of the highest cells: a thick root that continues behind the net pot has a flat top.
    """
    high = _top(plant, centre[:, 2], depth_mm)
    heavy = high[density[high] > 0.5 * density[high].max()]
    highest = heavy[centre[heavy, 2] == centre[heavy, 2].max()]
    return int(highest[np.linalg.norm(centre[highest] - centre[highest].mean(axis=0), axis=1).argmin()])


def _top(plant: Index, height_mm: Array, depth_mm: Array) -> Index:
    """Return the highest cells of a plant. Laterals that rise slightly above the taproot or hypocotyl are ignored."""
    highest = float(height_mm[plant].max())
    core_mm = float(height_mm[plant[depth_mm[plant] > 0.0]].max(initial=-np.inf))
    if highest - _RISE_MM < core_mm < highest - _TOP_MM:
        highest = core_mm
    return plant[(height_mm[plant] > highest - _TOP_MM) & (height_mm[plant] <= highest)]


def _smooth(cells: Cells) -> Array:
    """Return the density (N,) of cells after smoothing with a Gaussian of 0.7 cells, 1/mm.

    The density is the shadow area per volume.
    """
    density = cells.shadow_mm2.astype(np.float64) / cells.grid.size_mm**3
    beside = np.exp(-0.5 / _SMOOTH_CELLS**2)
    middle = 1.0 / (1.0 + 2.0 * beside)  # the Gaussian is truncated after the neighbours
    smooth = middle**3 * density
    for step, here, there in CellSet.from_cells(cells.index).neighbours():
        share = middle**3 * beside ** np.abs(step).sum()
        smooth[here] += share * density[there]
        smooth[there] += share * density[here]
    return smooth


def graph(cells: Cells, density: Array) -> csr_matrix:
    """Return a sparse graph (N, N) that connects each cell with its 26 neighbours, weighted by the cost of the path."""
    count = len(cells.index)
    cost = (1.0 / (density + _BRIDGE)).astype(np.float32)
    rows, columns, values = list[NDArray[np.int32]](), list[NDArray[np.int32]](), list[NDArray[np.float32]]()
    for step, here, there in CellSet.from_cells(cells.index).neighbours():
        way = np.float32(cells.grid.size_mm * np.linalg.norm(step))
        rows.append(here.astype(np.int32))
        columns.append(there.astype(np.int32))
        values.append(way * np.float32(0.5) * (cost[here] + cost[there]))
    return coo_matrix((_concatenate(values), (_concatenate(rows), _concatenate(columns))), shape=(count, count)).tocsr()


def _concatenate(parts: list[NDArray[T]]) -> NDArray[T]:
    """Concatenate arrays and clear the list, so that the data are not held twice in memory."""
    whole = np.concatenate(parts)
    parts.clear()
    return whole


def lengths(cost: Array, before: NDArray[np.int32], centre: Array) -> Array:
    """Compute the length (N,) of the path from each cell to the top by pointer doubling, mm.

    It is -1 for a cell without a path.
    """
    start = before < 0
    jump = np.where(start, np.arange(len(before)), before)
    length = np.where(start, 0.0, np.linalg.norm(centre - centre[jump], axis=1))
    while True:
        onward = jump[jump]
        if (onward == jump).all():
            return np.where(np.isfinite(cost), length, -1.0)
        length = length + length[jump]
        jump = onward


def branches(centre: Array, before: NDArray[np.int32], length: Array, claim_mm: Array, least_mm: float = _LEAST_MM) -> list[Index]:
    """Extract branches from the tree of shortest paths.

    Each branch is an array (n,) of cells, from a cell of its parent to its tip.

    Parameters
    ----------
    centre : (N, 3) float64 array
        Centres of the cells, mm.
    before : (N,) int32 array
        Preceding cell of each cell on its path, negative at the start.
    length : (N,) float64 array
        Length of each cell's path, mm; negative for cells that cannot be tips.
    claim_mm : (N,) float64 array
        Distance from each cell within which a branch through the cell claims other cells, mm.
    least_mm : float
        Minimum length of a branch within unclaimed cells, mm.
    """
    owned, left = np.zeros(len(centre), bool), length.copy()
    some = np.flatnonzero(left >= 0.0)
    tree, unclaimed = cKDTree(centre[some]), len(some)

    def claim(cell: int) -> int:
        """Claim the cells around a cell, and return how many were not claimed before."""
        near = some[tree.query_ball_point(centre[cell], claim_mm[cell])]
        new = int(np.count_nonzero(left[near] >= 0.0))
        left[near] = -1.0
        return new

    # Native Python numbers, several times as fast in a scalar loop.
    prior, taken, open_ = before.data, owned.data, left.data
    step = np.linalg.norm(centre - centre[np.maximum(before, 0)], axis=1).data
    lines: list[Index] = []
    for tip in np.argsort(-length, kind="stable"):
        if length[tip] <= 0:
            break
        if left[tip] < 0:
            continue
        way, fresh = [int(tip)], 0.0
        while prior[way[-1]] >= 0 and not taken[way[-1]]:
            fresh += step[way[-1]] if open_[way[-1]] >= 0.0 else 0.0
            way.append(prior[way[-1]])
        if fresh < max(least_mm, claim_mm[tip]):
            unclaimed -= claim(tip)
            continue
        line = np.array(way[::-1])
        # In taproot and hypocotyl the spheres are large: a few of them cover the path.
        for cell in line[_select_spaced(centre[line], claim_mm[line])]:
            unclaimed -= claim(cell)
        owned[line] = True
        lines.append(line)
        if unclaimed < _STILL_OPEN * len(some):  # the first branches claim most cells
            some = some[left[some] >= 0.0]
            tree = cKDTree(centre[some])
    return lines


def _select_spaced(line: Array, claim_mm: Array) -> list[int]:
    """Select cells along a line at a spacing of about a third of their claim distance.

    The claim distance is the distance within which other cells are assigned to the line. The last cell is always
    selected.
    """
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    chosen, begin = [0], 0
    for k in range(1, len(line)):
        if along[k] - along[begin] > claim_mm[k] / 3.0 or k == len(line) - 1:
            chosen.append(k)
            begin = k
    return chosen


def first_radius(path: Path) -> Array:
    """Return initial radii (N,) along a path, mm. The diameter is the shadow area per millimetre of length."""
    way = np.gradient(np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path.points_mm, axis=0), axis=1))]))
    share = gaussian_filter1d(path.shadow_mm2, 3.0, mode="nearest") / gaussian_filter1d(way, 3.0, mode="nearest")
    radius: Array = np.clip(0.5 * share, *_THIN_MM)
    return radius
