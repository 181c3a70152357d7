"""From a density to centre lines: the tree of easiest paths to the top of the root system.

The paths from every cell to the top (Dijkstra), with a cost a millimetre that falls with the density, form a tree.
Branches are read off it as TEASAR does (Sato et al. 2000, Pacific Graphics): the path from the farthest cell that no
branch has claimed yet is a branch down to where it meets another; it claims the cells about it; and so on until no
dense cell is left. Gaps are bridged where the search space allows it, or the net pot hides them, at a cost.
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

from rhizotwin.recon.hull.boxes import Scattered
from rhizotwin.recon.roots import crown
from rhizotwin.recon.roots.density import Cells

Array = NDArray[np.float64]
Index = NDArray[np.int64]
T = TypeVar("T", bound=np.generic)

_SMOOTH_CELLS = 0.7
"""Standard deviation of the smoothing of the density: noise of single cells is no ridge."""
_CAP = 37.5
"""Density (shadow a volume, 1/mm) above which more tells nothing."""
_BRIDGE = 0.125
"""Density, 1/mm, that empty cells of the search space count for: a root of 0.3 mm has about 2."""
_DENSE = 0.25
"""Density, 1/mm, from which a cell must belong to a branch."""
_IN_CORE, _BY_DEPTH = 10.0, 100.0
"""Density given to cells inside taproot and hypocotyl, and its rise with depth, a mm: paths keep to their middle."""
CLAIM_CELLS = 1.5
"""Cells this near to a traced root are its own."""
_STILL_OPEN = 0.5
"""Cells to be claimed are sorted anew where fewer than this share of those sorted are left: each time costs as much as
all times after it."""
_CORE_CLAIM_MM = 0.65
"""Cells this far beyond the core about a path in a taproot or hypocotyl are claimed with it."""
_LEAST_MM = 1.0
"""A root shorter than this is not traced."""
_TOP_MM, _RISE_MM = 1.0, 6.0
"""The plant's top is sought in its highest millimetre; laterals rise so far above what is seen of the stem, at most."""
_THIN_MM = (0.05, 0.3)
"""Radii that shadows can tell at the start; thicker roots shade their own cells."""


@dataclass(frozen=True)
class Path:
    """A branch as it was traced."""

    points_mm: Array
    """(N, 3) from where it leaves its parent to its tip; the first point is one of the parent's."""
    shadow_mm2: Array
    """(N,) shadow of the cells about each point."""


def core_depth(cells: Cells, core: NDArray[np.int32], *, reach_mm: float, most_mm: float = np.inf) -> Array:
    """Return how deep (N,) cells lie in a core, mm; outside it is less the distance to the core.

    Parameters
    ----------
    cells : Cells
        Whose depth is asked.
    core : (M, 3) int32 array
        Cells of the core, on the same lattice.
    reach_mm : float
        What lies farther from the core is so far from it.
    most_mm : float
        What lies deeper is so deep.
    """
    depth = np.full(len(cells.index), -reach_mm)
    if not len(core):
        return depth
    full = Scattered.of(core)
    rim, beyond = full.faces()  # the nearest cell of the other kind is one of those that touch this kind with a face
    inside, size_mm = full.holds(cells.index), cells.grid.size_mm
    deep = cKDTree(beyond).query(cells.index[inside], distance_upper_bound=most_mm / size_mm, workers=-1)[0]
    depth[inside] = np.minimum(deep * size_mm, most_mm)
    away = cKDTree(core[rim]).query(cells.index[~inside], distance_upper_bound=reach_mm / size_mm, workers=-1)[0]
    depth[~inside] = np.maximum(-away * size_mm, -reach_mm)
    return depth


def trace(cells: Cells, depth_mm: Array) -> list[Path]:
    """Trace the branches of a density.

    Parameters
    ----------
    cells : Cells
        Search space with shadows.
    depth_mm : (N,) float64 array
        Depth of the cells in the cores of taproot and hypocotyl, as from `core_depth`; cells that lie outside of a core
        but not as far as the lowest of the depths belong to the organ and bear no tips.

    Returns
    -------
    Branches, parents before children; empty where nothing is dense.
    """
    density, thin = _IN_CORE + _BY_DEPTH * depth_mm, depth_mm <= 0
    density[thin] = np.minimum(_smooth(cells.chosen(thin)), _CAP)  # cells of a core have no shadow
    dense = (density > _DENSE) & ((depth_mm > 0) | (depth_mm <= depth_mm.min()))
    if not dense.any():
        return []
    centre = cells.centre_mm
    joined = graph(cells, density)
    members = crown.members(centre, dense, cells.tops_mm)
    if not members:
        # The top of what hangs together best: a fibre of the felt or a bubble may reach higher than the plant.
        # with the organs, and what lies between them and the roots on them
        body = (density > _DENSE) | (depth_mm > depth_mm.min())
        number, part = np.flatnonzero(body), Scattered.of(cells.index[body]).parts()
        plant = number[part == np.bincount(part, weights=cells.shadow_mm2[body]).argmax()]
        members = {-1: plant[dense[plant]]}
    starts = {top: _start(plant, centre[:, 2], density, depth_mm) for top, plant in members.items()}
    joined = joined + _behind_net_pot(cells, dense, np.array(list(starts.values())))
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
    return [Path(*path) for path in crown.hang(hung, under, cells.grid.size_mm)] if under else paths


def _behind_net_pot(cells: Cells, dense: NDArray[np.bool_], starts: Index) -> csr_matrix:
    """Join parts of the search space that meet only where the net pot hides them, at the cost of empty cells: (N, N).

    A part whose dense cells come as near to the top of a plant as the hidden base of one may reach is joined there.
    """
    centre, part = cells.centre_mm, Scattered.of(cells.index).parts()
    begun, top_mm = np.isin(part, part[starts]), centre[starts, 2].min()
    heads = np.flatnonzero(dense & begun & (centre[:, 2] > top_mm - _TOP_MM))
    high = np.flatnonzero(dense & ~begun & (centre[:, 2] > top_mm - crown.HIDDEN_MM))
    away, nearest = cKDTree(centre[heads]).query(centre[high], distance_upper_bound=crown.HIDDEN_MM)
    order = np.argsort(away, kind="stable")
    order = order[np.isfinite(away[order])]
    first = order[np.unique(part[high[order]], return_index=True)[1]]
    shape = (len(centre), len(centre))
    return coo_matrix(((away[first] / _BRIDGE).astype(np.float32), (heads[nearest[first]], high[first])), shape=shape).tocsr()


def _start(plant: Index, height_mm: Array, density: Array, depth_mm: Array) -> int:
    """Return the cell at a plant's top from which its roots are traced."""
    high = _top(plant, height_mm, depth_mm)
    heavy = high[density[high] > 0.5 * density[high].max()]
    return int(heavy[height_mm[heavy].argmax()])


def _top(plant: Index, height_mm: Array, depth_mm: Array) -> Index:
    """Return the highest cells of a plant; where its laterals alone reach a little higher, its organ's."""
    highest = float(height_mm[plant].max())
    core_mm = float(height_mm[plant[depth_mm[plant] > 0.0]].max(initial=-np.inf))
    if highest - _RISE_MM < core_mm < highest - _TOP_MM:
        highest = core_mm
    return plant[(height_mm[plant] > highest - _TOP_MM) & (height_mm[plant] <= highest)]


def _smooth(cells: Cells) -> Array:
    """Return the density (N,) of cells, shadow a volume in 1/mm, smoothed by a Gaussian of 0.7 cells."""
    density = cells.shadow_mm2.astype(np.float64) / cells.grid.size_mm**3
    beside = np.exp(-0.5 / _SMOOTH_CELLS**2)
    middle = 1.0 / (1.0 + 2.0 * beside)  # cut off at the neighbours
    smooth = middle**3 * density
    for step, here, there in Scattered.of(cells.index).neighbours():
        share = middle**3 * beside ** np.abs(step).sum()
        smooth[here] += share * density[there]
        smooth[there] += share * density[here]
    return smooth


def graph(cells: Cells, density: Array) -> csr_matrix:
    """Join each cell (N,) with its 26 neighbours at the cost of the way between their centres: (N, N)."""
    count = len(cells.index)
    cost = (1.0 / (density + _BRIDGE)).astype(np.float32)
    rows, columns, values = list[NDArray[np.int32]](), list[NDArray[np.int32]](), list[NDArray[np.float32]]()
    for step, here, there in Scattered.of(cells.index).neighbours():
        way = np.float32(cells.grid.size_mm * np.linalg.norm(step))
        rows.append(here.astype(np.int32))
        columns.append(there.astype(np.int32))
        values.append(way * np.float32(0.5) * (cost[here] + cost[there]))
    return coo_matrix((_strung(values), (_strung(rows), _strung(columns))), shape=(count, count)).tocsr()


def _strung(parts: list[NDArray[T]]) -> NDArray[T]:
    """Put arrays one after the other; the list is used up, so that they are not held twice."""
    whole = np.concatenate(parts)
    parts.clear()
    return whole


def lengths(cost: Array, before: NDArray[np.int32], centre: Array) -> Array:
    """Return the length (N,) of each cell's path, mm, by pointer doubling."""
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
    """Read branches off the tree of paths: cells (n,) of each, from the cell of its parent to its tip.

    Parameters
    ----------
    before : (N,) int32 array
        The cell before each on its path, negative at its beginning.
    length : (N,) float64 array
        Of the paths, mm; negative where a cell is no tip.
    claim_mm : (N,) float64 array
        Cells this near a branch belong to it.
    least_mm : float
        Length that a branch must have among cells that no other has claimed.
    """
    owned, left = np.zeros(len(centre), bool), length.copy()
    some = np.flatnonzero(left >= 0.0)
    tree = cKDTree(centre[some])
    # numbers of Python's own, several times as fast one by one
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
            left[some[tree.query_ball_point(centre[tip], claim_mm[tip])]] = -1.0
            continue
        line = np.array(way[::-1])
        # in taproot and hypocotyl the spheres are large: a few of them cover the way
        for cell in line[_apart(centre[line], claim_mm[line])]:
            left[some[tree.query_ball_point(centre[cell], claim_mm[cell])]] = -1.0
        owned[line] = True
        lines.append(line)
        unclaimed = some[left[some] >= 0.0]
        if len(unclaimed) < _STILL_OPEN * len(some):  # the first branches claim most
            some, tree = unclaimed, cKDTree(centre[unclaimed])
    return lines


def _apart(line: Array, claim_mm: Array) -> list[int]:
    """Choose cells along a line no farther apart than a third of what they claim, the last one included."""
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    chosen, begin = [0], 0
    for k in range(1, len(line)):
        if along[k] - along[begin] > claim_mm[k] / 3.0 or k == len(line) - 1:
            chosen.append(k)
            begin = k
    return chosen


def first_radius(path: Path) -> Array:
    """Guess radii (N,) along a path: the shadow of a millimetre of root is its diameter."""
    way = np.gradient(np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path.points_mm, axis=0), axis=1))]))
    share = gaussian_filter1d(path.shadow_mm2, 3.0, mode="nearest") / gaussian_filter1d(way, 3.0, mode="nearest")
    radius: Array = np.clip(0.5 * share, *_THIN_MM)
    return radius
