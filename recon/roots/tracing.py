"""Tracing of centre lines from the density: a tree of shortest paths to the top of the root system.

The cost of a path per millimetre decreases with the density. The shortest paths from all cells to the top (Dijkstra)
form a tree, from which branches are extracted as in TEASAR (Sato et al. 2000, Pacific Graphics). The path from the
farthest unclaimed cell to the first branch that it meets becomes a new branch, which claims the cells around it. This
is repeated until no dense cell is left. Gaps within the search space, and gaps hidden by the net pot, are bridged at a
cost.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from scipy.spatial import cKDTree

from rhizotwin.recon.hull.boxes import CellSet
from rhizotwin.recon.lattice import cells as lattices
from rhizotwin.recon.lattice import distances
from rhizotwin.recon.lattice.cells import Lattice, Paths
from rhizotwin.recon.roots import crown
from rhizotwin.recon.roots.density import Cells

Array = NDArray[np.float64]
Index = NDArray[np.int64]

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
_CORE_CLAIM_MM = 0.65
"""Distance beyond the surface of the core within which cells are assigned to a path in the taproot or hypocotyl, mm."""
_LEAST_MM = 1.0
"""Minimum length of a traced root, mm."""
_TOP_MM, _RISE_MM = 1.0, 6.0
"""Height below the highest cell within which the top of a plant is searched, mm, and height above the visible stem up
to which laterals are ignored in this search, mm."""
_TOP_ZONE = 0.25
"""Fraction of the zone below the net pot within which the tops of all plants and roots lie: the opaque pot hides the
topmost part of each."""
_STEEP, _APPROACH = np.cos(np.deg2rad(45.0)), 0.25
"""Minimum cosine of the angle between the vertical and the upper part of a root that comes from the net pot, and
maximum distance by which it approaches a plant, as a fraction of its descent (`_comes_from_pot`)."""
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


def core_depth(cells: Cells, core: NDArray[np.int32], *, reach_mm: float) -> Array:
    """Return the depth (N,) of cells inside a core, mm. Outside, it is the negative distance from the core.

    Parameters
    ----------
    cells : Cells
        Cells for which the depth is computed.
    core : (M, 3) int32 array
        Cells of the core, on the same lattice.
    reach_mm : float
        Upper limit of the distance outside the core, mm.
    """
    if not len(core):
        return np.full(len(cells.index), -reach_mm)
    size_mm, order = cells.grid.size_mm, lattices.sort(cells.index)
    inner, depth = distances.depth(core), np.empty(len(order))
    # Only cells of the rim, which are one cell deep, can be nearest to a cell outside.
    reach = np.where(inner == 1.0, max(reach_mm / size_mm, 0.5), 0.5)
    away, nearest = lattices.find_nearest(Lattice.of(cells.index[order]), core.astype(np.float64), reach)
    inside = away == 0.0
    depth[order] = -np.minimum(away * size_mm, reach_mm)
    depth[order[inside]] = inner[nearest[inside]] * size_mm
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
    order = lattices.sort(cells.index)
    cells, depth_mm = cells.select(order), depth_mm[order]
    lattice, centre, size_mm = Lattice.of(cells.index), cells.centre_mm, cells.grid.size_mm
    shadow = cells.shadow_mm2.astype(np.float64) / size_mm**3
    density, thin = _IN_CORE + _BY_DEPTH * depth_mm, depth_mm <= 0
    beside = np.exp(-0.5 / _SMOOTH_CELLS**2)  # the Gaussian is truncated after the neighbours
    smooth = lattices.smooth(lattice, shadow, beside ** np.arange(4.0) / (1.0 + 2.0 * beside) ** 3)
    density[thin] = np.minimum(smooth[thin], _CAP)
    dense = (density > _DENSE) & ((depth_mm > 0) | (depth_mm <= depth_mm.min()))
    if not dense.any():
        return []
    members = crown.find_top_cells(centre, dense, cells.tops_mm)
    if not members:
        # Use the top of the heaviest connected part, including the organs and the cells between them and their roots: a
        # fibre of the felt or a bubble may lie higher than the plant.
        body = (density > _DENSE) | (depth_mm > depth_mm.min())
        number, part = np.flatnonzero(body), CellSet.from_cells(cells.index[body]).components()
        plant = number[part == np.bincount(part, weights=cells.shadow_mm2[body]).argmax()]
        members = {-1: plant[dense[plant]]}
    starts = {top: _start(plant, centre, density, depth_mm) for top, plant in members.items()}
    begun = np.array(list(starts.values()))
    found = find_paths(lattice, density, begun)
    _bridge_net_pot(cells, lattice, density, dense, found, float(centre[begun, 2].min()))
    separate = [_start(root, centre, density, depth_mm) for root in _find_separate(cells, dense, found, begun)]
    _extend(lattice, density, np.array(separate, np.int64), found)
    claim = np.where(depth_mm > 0, depth_mm + _CORE_CLAIM_MM, CLAIM_CELLS * size_mm)
    lines = branches(lattice, found, dense, claim / size_mm, _LEAST_MM / size_mm)
    if not lines:
        return []
    some = np.flatnonzero(cells.shadow_mm2)
    nearest = cKDTree(centre[np.concatenate(lines)]).query(centre[some], workers=-1)[1]
    total = np.bincount(nearest, weights=cells.shadow_mm2[some], minlength=sum(len(line) for line in lines)).astype(np.float64)
    shadows = np.split(total, np.cumsum([len(line) for line in lines])[:-1])
    paths = [Path(centre[line], shadow) for line, shadow in zip(lines, shadows, strict=True)]
    under = {starts[top]: cells.tops_mm[top] for top in members if top >= 0}
    if separate:
        z_mm = cells.tops_mm[0][2]
        under |= {cell: (*centre[cell, :2].tolist(), z_mm) for cell in (*starts.values(), *separate) if cell not in under}
    hung = [(int(line[0]), path.points_mm, path.shadow_mm2) for line, path in zip(lines, paths, strict=True)]
    return [Path(*path) for path in crown.attach_paths(hung, under, cells.grid.size_mm)] if under else paths


def _bridge_net_pot(cells: Cells, lattice: Lattice, density: Array, dense: NDArray[np.bool_], paths: Paths, top_mm: float) -> None:
    """Extend paths to separate parts of the search space behind the net pot.

    The cost per millimetre is that of empty cells. A part is connected to a plant if the distance of its dense cells
    from the plant's top, which is at the height ``top_mm``, does not exceed the maximum length of a hidden base.
    """
    centre, begun = cells.centre_mm, np.isfinite(paths.cost)
    heads = np.flatnonzero(dense & begun & (centre[:, 2] > top_mm - _TOP_MM))
    rest = np.flatnonzero(~begun)
    part, high = CellSet.from_cells(cells.index[rest]).components(), dense[rest] & (centre[rest, 2] > top_mm - crown.HIDDEN_MM)
    away, nearest = cKDTree(centre[heads]).query(centre[rest[high]], distance_upper_bound=crown.HIDDEN_MM)
    order = np.argsort(away, kind="stable")
    order = order[np.isfinite(away[order])]
    first = order[np.unique(part[high][order], return_index=True)[1]]
    head, begin, way = heads[nearest[first]], rest[high][first], away[first] / cells.grid.size_mm
    paths.before[begin] = head
    paths.cost[begin], paths.length[begin] = paths.cost[head] + way / _BRIDGE, paths.length[head] + way
    lattices.extend_paths(lattice, _resistance(density), begin, paths)


def _find_separate(cells: Cells, dense: NDArray[np.bool_], paths: Paths, starts: Index) -> list[Index]:
    """Return the dense cells near the top of each root that leaves the net pot far from the plants.

    Such a root is as high as a plant, descends through the whole zone in which tops are searched, and is neither
    connected to a plant nor as near as the maximum length of a hidden base within this zone. If it touches the plant's
    roots below, it may also be a lateral that has risen to the net pot: this approaches the plant as it descends, or is
    less steep (`_comes_from_pot`). A bubble or debris is smaller.

    Parameters
    ----------
    starts : (P,) int64 array
        Cells at the tops of the plants.
    """
    if not cells.tops_mm:
        return []
    centre, height_mm = cells.centre_mm, cells.centre_mm[:, 2]
    low_mm = height_mm[starts].min() - crown.HIDDEN_MM
    zone = np.union1d(np.flatnonzero(height_mm > low_mm), starts)
    part = CellSet.from_cells(cells.index[zone]).components()
    own = np.isin(part, part[np.searchsorted(zone, starts)])
    top, found = height_mm[zone] > height_mm[starts].min() - _TOP_ZONE * crown.HIDDEN_MM, list[Index]()
    plants = cKDTree(centre[zone[own & top], :2])
    for number in np.unique(part[~own & top & dense[zone]]):
        root = zone[(part == number) & dense[zone]]
        high = root[height_mm[root] > height_mm[root].max() - _TOP_MM]
        descends = height_mm[root].min() < low_mm + _TOP_ZONE * crown.HIDDEN_MM
        far = plants.query(centre[high, :2])[0].min() > crown.HIDDEN_MM
        if descends and far and (np.isinf(paths.cost[high]).all() or _comes_from_pot(centre[root], centre[starts])):
            found.append(root)
    return found


def _comes_from_pot(points_mm: Array, starts_mm: Array) -> bool:
    """Return whether the cells (N, 3) of a root's upper part are those of a root that comes from the net pot, mm.

    It is steep where it begins, and does not approach the nearest of the plants (P, 3) as it descends. In eleven
    plants, 8 laterals approach it by 0.5 to 2.2 times their descent, and 10 roots from the pot recede from it.
    """
    height = points_mm[:, 2]
    top, below, low = (
        points_mm[np.abs(height - z) <= _TOP_MM].mean(axis=0) for z in (height.max(), height.max() - 3.0 * _TOP_MM, height.min())
    )
    plant = starts_mm[np.linalg.norm(starts_mm[:, :2] - top[:2], axis=1).argmin()]
    nearer_mm = float(np.linalg.norm((top - plant)[:2]) - np.linalg.norm((low - plant)[:2]))
    is_steep = top[2] - below[2] >= _STEEP * np.linalg.norm(top - below)
    return bool(is_steep and nearer_mm <= _APPROACH * (top[2] - low[2]))


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


def _resistance(density: Array) -> Array:
    """Return the cost (N,) of a path per millimetre in each cell."""
    return 1.0 / (density + _BRIDGE)


def find_paths(lattice: Lattice, density: Array, starts: Index) -> Paths:
    """Return the shortest paths from the cells ``starts`` (S,) to all cells that are connected to them."""
    paths = Paths.none(len(density))
    _extend(lattice, density, starts, paths)
    return paths


def _extend(lattice: Lattice, density: Array, starts: Index, paths: Paths) -> None:
    """Add the shortest paths from the cells ``starts`` (S,) to all cells that are connected to them."""
    paths.cost[starts], paths.before[starts], paths.length[starts] = 0.0, -1, 0.0
    lattices.extend_paths(lattice, _resistance(density), starts, paths)


def branches(lattice: Lattice, paths: Paths, tips: NDArray[np.bool_], claim: Array, least: float) -> list[Index]:
    """Extract branches from the tree of shortest paths, the longest first.

    Each branch is an array (n,) of cells, from a cell of its parent to its tip.

    Parameters
    ----------
    tips : (N,) bool array
        Mask of cells that can be tips.
    claim, least : (N,) float64 array, float
        See `lattice.cells.extract_branches`.
    """
    some = np.flatnonzero(tips & np.isfinite(paths.cost) & (paths.length > 0.0))
    some = some[np.argsort(-paths.length[some], kind="stable")]
    flat, ends = lattices.extract_branches(lattice, paths, some, claim, least)
    return np.split(flat, ends)[:-1]


def first_radius(path: Path) -> Array:
    """Return initial radii (N,) along a path, mm. The diameter is the shadow area per millimetre of length."""
    way = np.gradient(np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path.points_mm, axis=0), axis=1))]))
    share = gaussian_filter1d(path.shadow_mm2, 3.0, mode="nearest") / gaussian_filter1d(way, 3.0, mode="nearest")
    radius: Array = np.clip(0.5 * share, *_THIN_MM)
    return radius
