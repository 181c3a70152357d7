"""Octree carving through the refraction: mark and refine over a set of leaves (T3.4.4), in Dr.Jit.

The water is cut into nodes. A node is *empty* when one view that sees all of it finds its whole footprint outside the
silhouette, *full* when all views that see it find its footprint inside, and is cut into eight otherwise, down to the
finest size. A view that does not see a node (or sees it twice, or whose picture says nothing there) neither carves it
nor counts for it; nodes that too few views see are *blind*: reported, and not part of the shape.

A node is its integer position on the grid of its level, so neighbours, parents and children are arithmetic on keys and
no tree is kept: the thesis's dictionary of leaves becomes arrays of positions, without a look-up.
"""

from __future__ import annotations

import functools
import math
import operator
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.coverage import silhouettes
from rhizotwin.recon.coverage.silhouettes import UNSEEN_PX, UPSAMPLING, Image, Silhouette, Window
from rhizotwin.recon.device import Bool, Float, Int32, Kernel, Point3f, UInt32, Vector2f, Vector2u, Vector3f, bilinear
from rhizotwin.recon.optics import projection
from rhizotwin.recon.optics.projection import ViewBank
from rhizotwin.scenes.monitor import Monitor

Array = NDArray[np.float64]
Index = NDArray[np.int32]

TELLS_PX = 1e-3 * UNSEEN_PX
"""Interpolated distances above this have a share of `UNSEEN_PX`: the picture says nothing there either."""
_VOTES, _FEWEST = 0.3, 3
"""Share of the views that must see a point for it to count, and their least number: two views leave open what lies
along their lines of sight."""
_COARSEST_MM = 4.6
"""Edge of the first nodes, at most: 33 across the canister."""
_BLIND_MM = 2.5
"""Larger nodes that too few views see are cut: some of their parts may be seen."""
_BY_PARENT_MM = 1.0
"""Nodes up to this edge are placed in the pictures by the Jacobian at their parent's centre (`_mark`)."""
_EMPTY, _PARTIAL = 1 << 31, 1 << 30
"""Bits of `_Marks.flags` above the votes."""
_CHUNK = 1 << 21
"""Nodes that are looked at in one kernel: 0.3 GB (`_BYTES_A_NODE`)."""
_BYTES_A_NODE = 150
"""Memory that a node of the finest level takes until the shape is written, as measured; Dr.Jit does not survive having
too little."""


@dataclass(frozen=True)
class Water:
    """The space in which roots can be."""

    radius_mm: float
    top_mm: float
    bottom_mm: float


@dataclass(frozen=True)
class DistanceMaps:
    """Signed distances to the outlines of all views, positive inside, pixels.

    `UNSEEN_PX` where a picture says nothing.
    """

    values: Float
    """mi.Float, (V, 2 h, 2 w) flattened: those of a window (w, h), about which nothing is said."""
    image_wh: tuple[int, int]
    window: Window
    _low: Vector2f = field(init=False, repr=False)
    _samples: Vector2u = field(init=False, repr=False)
    _image: Vector2f = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Keep what kernels need of the sizes as their input.

        As constants, they would make every kernel new for every scan.
        """
        object.__setattr__(self, "_low", mi.Vector2f(*(dr.opaque(mi.Float, low) for low in self.window.low_px)))
        object.__setattr__(self, "_samples", mi.Vector2u(*(dr.opaque(mi.UInt32, count) for count in self.samples_wh)))
        object.__setattr__(self, "_image", mi.Vector2f(*(dr.opaque(mi.Float, count) for count in self.image_wh)))

    @staticmethod
    def of(maps: NDArray[np.float32], image_wh: tuple[int, int] | None = None, window: Window | None = None) -> DistanceMaps:
        """Put maps (V, 2 h, 2 w) on the device.

        Parameters
        ----------
        image_wh, window : tuple of int or None, Window or None
            Of the pictures, and the part of them that the maps are of; all of it where not given.
        """
        size_px = maps.shape[2] // UPSAMPLING, maps.shape[1] // UPSAMPLING
        return DistanceMaps(mi.Float(maps.ravel()), image_wh or size_px, window or Window((0, 0), size_px))

    @staticmethod
    def drawn(
        views: Sequence[Silhouette], name: str, monitor: Monitor, outline: Callable[[Silhouette], Image] = silhouettes.signed_distance
    ) -> DistanceMaps:
        """Draw the outlines of all views, within the window that holds what any of them tells.

        Parameters
        ----------
        name : str
            Of the progress bar.
        outline : callable
            From a silhouette to its signed distance (2 H, 2 W), pixels.
        """
        (height, width), window = views[0].coverage.shape, Window.around(views)
        maps = np.empty((len(views), UPSAMPLING * window.size_px[1], UPSAMPLING * window.size_px[0]), np.float32)

        def draw(view: int) -> None:
            maps[view] = outline(views[view].cut(window))

        monitor.each(draw, name, range(len(views)))
        return DistanceMaps.of(maps, (width, height), window)

    @property
    def samples_wh(self) -> tuple[int, int]:
        """Return the samples of a map."""
        return self.window.size_px[0] * UPSAMPLING, self.window.size_px[1] * UPSAMPLING

    def sample(self, px: Vector2f) -> Vector2f:
        """Return where pixels (mi.Vector2f) lie on a map, whose samples are at integers: mi.Vector2f."""
        return (px - self._low + 0.5) * UPSAMPLING - 0.5

    def at(self, view: UInt32, px: Vector2f, active: Bool) -> Float:
        """Interpolate bilinearly at pixels (mi.Vector2f)."""
        place = dr.clip(self.sample(px), 0.0, mi.Vector2f(self._samples) - 1.001)
        return bilinear(self.values, view * (self._samples.y * self._samples.x), self._samples.x, place.x, place.y, active)

    def holds(self, px: Vector2f) -> Bool:
        """Tell which pixels (mi.Vector2f) lie in the pictures."""
        return dr.all((px > -0.5) & (px < self._image - 0.5))


def least_votes(count: int) -> int:
    """Return how many of so many views must see a point for it to count."""
    return max(_FEWEST, math.ceil(_VOTES * count))


@dataclass(frozen=True)
class Grid:
    """The cubic lattice of the finest nodes: node (i, j, k) covers origin + size * [i, i + 1] and so on."""

    origin_mm: Array
    size_mm: float
    levels: int
    """How often the coarsest nodes are halved."""
    coarse_shape: tuple[int, int, int]

    @staticmethod
    def over(low_mm: Array, high_mm: Array, size_mm: float) -> Grid:
        """Cover a box with a lattice whose planes x = 0 and y = 0 are node faces."""
        levels = max(0, int(np.floor(np.log2(_COARSEST_MM / size_mm))))
        coarse = size_mm * 2**levels
        first = np.floor(np.asarray(low_mm) / coarse)
        shape = np.maximum(np.ceil(np.asarray(high_mm) / coarse) - first, 1).astype(int)
        return Grid(first * coarse, size_mm, levels, (int(shape[0]), int(shape[1]), int(shape[2])))

    def edge_mm(self, level: int) -> float:
        """Return the edge of the nodes of a level; those of level 0 are the coarsest."""
        return self.size_mm * 2.0 ** (self.levels - level)


@dataclass(frozen=True)
class Leaves:
    """Occupied leaves of different sizes, all in units of the grid's finest nodes; they do not overlap."""

    grid: Grid
    index: Index
    """(N, 3) lowest corner."""
    size: Index
    """(N,) edge length, a power of two."""
    occupancy: NDArray[np.float32]
    """(N,) fraction inside the shape."""

    def volume_mm3(self, occupancy: NDArray[np.float32] | None = None) -> float:
        """Return the summed volume, also for other occupancies (N,) of the same leaves."""
        cubes = (self.size.astype(np.float64) * self.grid.size_mm) ** 3
        return float(cubes @ (self.occupancy if occupancy is None else occupancy).astype(np.float64))


@dataclass(frozen=True)
class Hull:
    """What carving leaves."""

    leaves: Leaves
    moved_in_mm3: float
    """Volume with every outline moved in by its uncertainty."""
    moved_out_mm3: float
    """Volume with every outline moved out by its uncertainty."""
    blind_mm3: float
    """Volume of the water that too few views see."""


def _footprint_px(p: projection.Projected, half_mm: Float) -> Float:
    """Return a bound of the distance in pixels from a cube's centre to any of its points, curvature included."""
    reach = mi.Float(0.0)
    for sy, sz in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
        du = p.du.x + sy * p.du.y + sz * p.du.z
        dv = p.dv.x + sy * p.dv.y + sz * p.dv.z
        reach = dr.maximum(reach, du * du + dv * dv)
    linear = dr.sqrt(reach) * half_mm
    return linear * (1.03 + 0.03 * half_mm) + 0.25  # the distance maps are right within 0.4 px and 2 %


def look(bank: ViewBank, maps: DistanceMaps, view: UInt32, point: Point3f, active: Bool) -> tuple[projection.Projected, Float, Bool]:
    """Project points into a view and read its distance map: (projection, distance in px, whether the picture tells)."""
    p = projection.project(bank, view, point, active)
    return p, *_read(maps, view, p.px, p.seen)


def _read(maps: DistanceMaps, view: UInt32, px: Vector2f, active: Bool) -> tuple[Float, Bool]:
    """Read a view's distance map: (distance in px, whether the picture tells)."""
    seen = active & maps.holds(px)
    distance = maps.at(view, px, seen)
    return distance, seen & (distance < TELLS_PX)


@dataclass
class _Marks:
    """What the views say of nodes."""

    empty: Bool
    """mi.Bool, whether a view finds a node empty."""
    partial: Bool
    """mi.Bool, whether a view finds it partly outside."""
    votes: UInt32
    """mi.UInt32, how many views see the centre."""
    depth: Float
    """mi.Float, signed distance in mm of the centre to the hull: the least over the views that see it ..."""
    scale: Float
    """mi.Float, ... and px per mm in that view."""

    def again(self, distance: Float, seen: Bool, clear: Bool, reach: Float, slack_px: Float, px_per_mm: Float) -> None:
        """Hear one more view of nodes that none has found empty yet."""
        open_ = ~self.empty
        seen &= open_
        self.partial |= seen & (distance < reach + slack_px)
        here = dr.select(seen, distance / px_per_mm, 1e3)
        self.scale = dr.select(here < self.depth, px_per_mm, self.scale)
        self.depth = dr.minimum(self.depth, here)
        self.votes += dr.select(seen, mi.UInt32(1), mi.UInt32(0))
        self.empty |= seen & clear & (distance < -reach - slack_px)

    def flags(self) -> UInt32:
        """Return votes, `_EMPTY` and `_PARTIAL` in one number."""
        zero = mi.UInt32(0)
        return self.votes | dr.select(self.empty, mi.UInt32(_EMPTY), zero) | dr.select(self.partial, mi.UInt32(_PARTIAL), zero)


def _mark(
    bank: ViewBank, maps: DistanceMaps, point: Point3f, parts: list[Vector3f], half_mm: Float, slack_px: Float, ignore_blindness: bool
) -> _Marks:
    """Look at nodes from every view, until one finds them empty.

    Only ``point`` is followed through the water; nodes beside it are placed by its Jacobian. What that neglects is half
    the change of the scale on the way (3 % a mm, as in `_footprint_px`) times the way: at most 0.011 of an edge where
    edges are below `_BY_PARENT_MM`.

    Parameters
    ----------
    parts : list of mi.Vector3f
        From the point to the centres of the nodes: eight for the children of a node about the point, or nothing but
        zero for itself.
    half_mm : mi.Float
        Half an edge of these nodes.

    Returns
    -------
    _Marks
        Of all nodes, those about a point side by side.
    """
    width = dr.width(point)

    def body(view: UInt32, marks: list[_Marks]) -> tuple[UInt32, list[_Marks]]:
        p = projection.project(bank, view, point, mi.Bool(True))
        reach, px_per_mm = _footprint_px(p, half_mm), dr.sqrt(dr.norm(p.du) * dr.norm(p.dv))
        for part, mark in zip(parts, marks, strict=True):
            px = p.px + mi.Vector2f(dr.dot(p.du, part), dr.dot(p.dv, part))
            distance, seen = _read(maps, view, px, p.seen & ~mark.empty)
            mark.again(distance, seen, p.clear_mm > 1.5 * half_mm + dr.norm(part), reach, slack_px, px_per_mm)
            if ignore_blindness:
                mark.empty |= ~seen
        return view + 1, marks

    def undecided(view: UInt32, marks: list[_Marks]) -> Bool:
        return (view < bank.end) & ~functools.reduce(operator.and_, [mark.empty for mark in marks])

    def begin(kind: type, value: float) -> Kernel:
        return dr.full(kind, value, width)

    marks = [
        _Marks(begin(mi.Bool, False), begin(mi.Bool, False), begin(mi.UInt32, 0), begin(mi.Float, 1e3), begin(mi.Float, 1.0)) for _ in parts
    ]
    marks = dr.while_loop((mi.UInt32(0), marks), undecided, body)[1]
    # one scatter for each field, and all in one kernel: each further kernel would run the loop again
    lane, count = dr.arange(mi.UInt32, width), len(parts) * width
    flags, depth, scale = dr.empty(mi.UInt32, count), dr.empty(mi.Float, count), dr.empty(mi.Float, count)
    dr.scatter(flags, mi.ArrayXu([mark.flags() for mark in marks]), lane)
    dr.scatter(depth, mi.ArrayXf([mark.depth for mark in marks]), lane)
    dr.scatter(scale, mi.ArrayXf([mark.scale for mark in marks]), lane)
    dr.eval(flags, depth, scale)
    return _Marks((flags & _EMPTY) != 0, (flags & _PARTIAL) != 0, flags & (_PARTIAL - 1), depth, scale)


def _partly_seen(bank: ViewBank, maps: DistanceMaps, point: Point3f, half_mm: Float, asked: Bool, min_votes: int) -> Bool:
    """Tell which nodes have a corner that enough views see, though too few see the centre.

    The edge of the blind zone cuts them.
    """
    result = dr.zeros(mi.Bool, dr.width(point))
    chosen = dr.compress(asked)
    if dr.width(chosen) == 0:
        return result
    part = dr.gather(mi.Point3f, point, chosen)
    some, least = dr.zeros(mi.Bool, dr.width(chosen)), dr.opaque(mi.UInt32, min_votes)

    def undecided(view: UInt32, votes: UInt32) -> Bool:
        return (view < bank.end) & (votes < least) & (votes + (bank.end - view) >= least)

    for offset in _corners(half_mm):
        at = part + offset

        def body(view: UInt32, votes: UInt32, at: Point3f = at) -> tuple[UInt32, UInt32]:
            seen = look(bank, maps, view, at, mi.Bool(True))[2]
            return view + 1, votes + dr.select(seen, mi.UInt32(1), mi.UInt32(0))

        state = (mi.UInt32(0), dr.select(some, least, mi.UInt32(0)))
        some |= dr.while_loop(state, undecided, body)[1] >= least
        dr.eval(some)
    dr.scatter(result, some, chosen)
    return result


def carve(
    bank: ViewBank,
    maps: DistanceMaps,
    grid: Grid,
    water: Water,
    *,
    min_votes: int,
    slack_px: float = 0.3,
    ignore_blindness: bool = False,
    progress: Callable[[], object] | None = None,
) -> Hull:
    """Carve the hull of the silhouettes out of the water.

    Parameters
    ----------
    water : Water
        Nodes outside of it are left out.
    min_votes : int
        Views that must see a node for it to count as part of the shape.
    slack_px : float
        Outline uncertainty; moves the outlines in and out for `Hull.moved_in_mm3` and ``moved_out_mm3``.
    ignore_blindness : bool
        The thesis's way: a view that does not see a node carves it.
    progress : callable, optional
        Called when a level is done.
    """
    i, j, k = (a.ravel() for a in np.meshgrid(*(np.arange(n, dtype=np.int32) for n in grid.coarse_shape), indexing="ij"))
    carving, nodes = _Carving(bank, maps, grid, water, min_votes, slack_px, ignore_blindness), [mi.Int32(i), mi.Int32(j), mi.Int32(k)]
    done = [_Decided(np.zeros((0, 3), np.int32), np.zeros(0, np.int32), np.zeros((3, 0), np.float32), 0.0, None)]
    for level in range(grid.levels + 1):
        by_parent = level > 0 and grid.edge_mm(level) <= _BY_PARENT_MM
        if level > 0 and not by_parent:
            nodes = _children(nodes)
        chunk, kept = _CHUNK // 8 if by_parent else _CHUNK, list[list[Int32]]()
        for begin in range(0, dr.width(nodes[0]), chunk):
            lane = dr.arange(mi.UInt32, begin, min(begin + chunk, dr.width(nodes[0])))
            part = [dr.gather(mi.Int32, a, lane) for a in nodes]
            decided = carving.decide(part, level, by_parent=by_parent)
            if decided is not None:
                done.append(decided)
                kept += [] if decided.split is None else [decided.split]
        nodes = kept[0] if len(kept) == 1 else [dr.concat([part[axis] for part in kept]) if kept else mi.Int32() for axis in range(3)]
        if progress:
            progress()
        if dr.width(nodes[0]) == 0:
            break
        _check_memory(8 * dr.width(nodes[0]))
    best, low, high = np.concatenate([part.occupancy for part in done], axis=1)
    leaves = Leaves(grid, np.concatenate([part.index for part in done]), np.concatenate([part.size for part in done]), best)
    return Hull(leaves, leaves.volume_mm3(low), leaves.volume_mm3(high), sum(part.blind_mm3 for part in done))


@dataclass(frozen=True)
class _Decided:
    """What became of nodes of one size."""

    index: Index
    """(N, 3) lowest corner of those that are part of the shape, in finest nodes."""
    size: Index
    """(N,)"""
    occupancy: NDArray[np.float32]
    """(3, N) best, least and most: with the outlines where they are, moved in, and moved out."""
    blind_mm3: float
    """Volume of those that too few views see."""
    split: list[Int32] | None
    """Those that are to be cut; None on the finest level."""


@dataclass(frozen=True)
class _Carving:
    """From what and how is carved."""

    bank: ViewBank
    maps: DistanceMaps
    grid: Grid
    water: Water
    min_votes: int
    slack_px: float
    ignore_blindness: bool

    def decide(self, part: list[Int32], level: int, *, by_parent: bool) -> _Decided | None:
        """Look at nodes of a level; None where all lie outside of the water.

        Parameters
        ----------
        part : list of mi.Int32
            The nodes, or with ``by_parent`` those that are to be cut into them.
        """
        grid, slack_px, water = self.grid, self.slack_px, self.water
        units, edge_mm = 2 ** (grid.levels - level), grid.edge_mm(level)
        half_mm = dr.opaque(mi.Float, 0.5 * edge_mm)
        if not by_parent:
            part = _compress(part, self._inside(_centres(grid, part, edge_mm), edge_mm))
            if dr.width(part[0]) == 0:
                return None
        about = _centres(grid, part, 2.0 * edge_mm if by_parent else edge_mm)
        parts = _corners(half_mm) if by_parent else [mi.Vector3f(dr.opaque(mi.Float, 0.0))]
        marks = _mark(self.bank, self.maps, about, parts, half_mm, dr.opaque(mi.Float, slack_px), self.ignore_blindness)
        part = _children(part) if by_parent else part
        point = _centres(grid, part, edge_mm)
        empty, partial, votes, depth, scale = marks.empty, marks.partial, marks.votes, marks.depth, marks.scale
        if by_parent:
            empty |= ~self._inside(point, edge_mm)
        blind = ~empty & (votes < self.min_votes) & (edge_mm <= max(_BLIND_MM, 1.01 * grid.size_mm))
        if level < grid.levels:
            blind &= ~_partly_seen(self.bank, self.maps, point, half_mm, blind, self.min_votes)
        full = ~empty & ~blind & ~partial & (votes >= self.min_votes)
        split = ~empty & ~blind & ~full
        in_radius = dr.square(point.x) + dr.square(point.y) < water.radius_mm**2
        chosen, measured = full, None
        if units == 1:
            # the finest nodes that no view decides are measured
            moves = (0.0, -slack_px / scale, slack_px / scale)
            measured = [dr.select(full, 1.0, dr.clip(0.5 + (depth + move) / grid.size_mm, 0.0, 1.0)) for move in moves]
            chosen = full | (split & in_radius & (measured[2] > 0))
            dr.eval(blind, chosen, measured)
        else:
            dr.eval(blind, chosen, split)
        blind &= in_radius & (point.z < water.top_mm) & (point.z > water.bottom_mm)
        index = np.stack([np.array(a) for a in _compress(part, chosen)], axis=1).astype(np.int32)
        occupancy = np.ones((3, len(index)), np.float32)
        if measured is not None:
            occupancy = np.stack([np.array(a) for a in _compress(measured, chosen)]).astype(np.float32)
        return _Decided(
            index=index * units,
            size=np.full(len(index), units, np.int32),
            occupancy=occupancy,
            blind_mm3=float(dr.count(blind)[0]) * edge_mm**3,
            split=_compress(part, split) if measured is None else None,
        )

    def _inside(self, point: Point3f, edge_mm: float) -> Bool:
        """Tell which nodes lie in the water, at least in part."""
        water = self.water
        inside = dr.square(point.x) + dr.square(point.y) < dr.opaque(mi.Float, (water.radius_mm + 0.71 * edge_mm) ** 2)
        return (
            inside
            & (point.z < dr.opaque(mi.Float, water.top_mm + 0.5 * edge_mm))
            & (point.z > dr.opaque(mi.Float, water.bottom_mm - 0.5 * edge_mm))
        )


def _centres(grid: Grid, nodes: list[Int32], edge_mm: float) -> Point3f:
    """Return the centres of nodes of one size."""
    edge = dr.opaque(mi.Float, edge_mm)
    return mi.Point3f(*((mi.Float(nodes[a]) + 0.5) * edge + dr.opaque(mi.Float, float(grid.origin_mm[a])) for a in range(3)))


def _corners(half_mm: Float) -> list[Vector3f]:
    """Return from a node's centre to its corners, in the order of `_children`.

    Signs that are no constants leave one kernel for all.
    """
    signs = [dr.opaque(mi.Float, sign) for sign in (-1.0, 1.0)]
    return [mi.Vector3f(*(half_mm * signs[c] for c in corner)) for corner in np.ndindex(2, 2, 2)]


def _compress(arrays: list[Kernel], mask: Bool) -> list[Kernel]:
    """Keep the entries of a mask."""
    chosen = dr.compress(mask)
    return [dr.gather(type(a), a, chosen) for a in arrays]


def _check_memory(count: int) -> None:
    """Raise a MemoryError where so many nodes do not fit in the computer."""
    fitting = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") // _BYTES_A_NODE
    if count > fitting:
        raise MemoryError(f"{count} nodes to be carved, but only {fitting} fit")


def _children(nodes: list[Int32]) -> list[Int32]:
    """Cut nodes into eight, children of one node side by side."""
    lane = dr.arange(mi.UInt32, 8 * dr.width(nodes[0]))
    parent, child = lane >> 3, lane & 7
    bits = [(child >> 2) & 1, (child >> 1) & 1, child & 1]
    found = [2 * dr.gather(mi.Int32, nodes[a], parent) + mi.Int32(bits[a]) for a in range(3)]
    dr.eval(found)
    return found
