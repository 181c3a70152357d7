"""Classification of octree nodes from the silhouettes of all views. A node is empty, partly outside or inside."""

from __future__ import annotations

import functools
import operator
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from rhizotwin.recon.device import Bool, Float, Kernel, Point3f, UInt32, Vector3f
from rhizotwin.recon.hull import distance_maps
from rhizotwin.recon.hull.distance_maps import DistanceMaps
from rhizotwin.recon.optics import projection
from rhizotwin.recon.optics.projection import ViewBank

_EMPTY, _PARTIAL = 1 << 31, 1 << 30
"""Bits for `Marks.empty` and `Marks.partial` in the integer that stores the classification of a node. The lower bits
contain the number of views that show the node."""


def _footprint_px(p: projection.Projected, half_mm: Float) -> Float:
    """Return an upper bound of the projected distance from a cube's centre to any of its points, px."""
    reach = mi.Float(0.0)
    for sy, sz in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
        du = p.du.x + sy * p.du.y + sz * p.du.z
        dv = p.dv.x + sy * p.dv.y + sz * p.dv.z
        reach = dr.maximum(reach, du * du + dv * dv)
    linear = dr.sqrt(reach) * half_mm
    return linear * (1.03 + 0.03 * half_mm) + 0.25  # the distance maps are accurate to 0.4 px and 2 %


@dataclass
class Marks:
    """Classification of octree nodes by all views."""

    empty: Bool
    """Whether a node is empty in at least one view (mi.Bool)."""
    partial: Bool
    """Whether a node is partly outside the silhouette in at least one view (mi.Bool)."""
    votes: UInt32
    """Number of views that show a node's centre (mi.UInt32)."""
    depth: Float
    """Signed distance from a node's centre to the hull's surface, mm (mi.Float). It is the minimum over the views that
    show the centre."""
    scale: Float
    """Image scale in the view that determines `depth`, px/mm (mi.Float)."""

    def flags(self) -> UInt32:
        """Pack the classification of each node into one integer, which consists of the number of votes and two bits.

        The bits are `_EMPTY` and `_PARTIAL`.
        """
        zero = mi.UInt32(0)
        return self.votes | dr.select(self.empty, mi.UInt32(_EMPTY), zero) | dr.select(self.partial, mi.UInt32(_PARTIAL), zero)


def mark_nodes(bank: ViewBank, maps: DistanceMaps, point: Point3f, parts: list[Vector3f], half_mm: Float, slack_px: Float) -> Marks:
    """Classify nodes in all views. A node is not tested further after the first view in which it is empty.

    Only ``point`` is projected with refraction at the canister. Nodes around it are located with the Jacobian of that
    projection. The error is half the change of the scale over the offset (3 % per mm, as in `_footprint_px`) times the
    offset. It is at most 0.011 of an edge for edges shorter than `carve.BY_PARENT_MM`.

    Parameters
    ----------
    parts : list of mi.Vector3f
        Offsets from ``point`` to the centres of the nodes: eight offsets for the children of a node centred at
        ``point``, or a single zero offset for the node itself.
    half_mm : mi.Float
        Half the edge length of the nodes to be classified, mm.

    Returns
    -------
    Marks
        Classification of all nodes. Nodes at the same point are consecutive.
    """
    width = dr.width(point)

    def body(view: UInt32, marks: list[Marks]) -> tuple[UInt32, list[Marks]]:
        p = projection.project(bank, view, point, mi.Bool(True))
        reach, px_per_mm = _footprint_px(p, half_mm), dr.sqrt(dr.norm(p.du) * dr.norm(p.dv))
        for part, mark in zip(parts, marks, strict=True):
            px = p.px + mi.Vector2f(dr.dot(p.du, part), dr.dot(p.dv, part))
            distance, usable = distance_maps.read(maps, view, px, p.visible & ~mark.empty)
            mark.partial |= usable & (distance < reach + slack_px)
            depth = dr.select(usable, distance / px_per_mm, 1e3)
            mark.scale = dr.select(depth < mark.depth, px_per_mm, mark.scale)
            mark.depth = dr.minimum(mark.depth, depth)
            mark.votes += dr.select(usable, mi.UInt32(1), mi.UInt32(0))
            # The whole node must lie outside the view's blind zone.
            mark.empty |= usable & (p.clear_mm > 1.5 * half_mm + dr.norm(part)) & (distance < -reach - slack_px)
        return view + 1, marks

    def undecided(view: UInt32, marks: list[Marks]) -> Bool:
        return (view < bank.end) & ~functools.reduce(operator.and_, [mark.empty for mark in marks])

    def begin(kind: type, value: float) -> Kernel:
        return dr.full(kind, value, width)

    marks = [
        Marks(begin(mi.Bool, False), begin(mi.Bool, False), begin(mi.UInt32, 0), begin(mi.Float, 1e3), begin(mi.Float, 1.0)) for _ in parts
    ]
    marks = dr.while_loop((mi.UInt32(0), marks), undecided, body)[1]
    # One scatter per field, all in one kernel: each additional kernel would repeat the loop.
    lane, count = dr.arange(mi.UInt32, width), len(parts) * width
    flags, depth, scale = dr.empty(mi.UInt32, count), dr.empty(mi.Float, count), dr.empty(mi.Float, count)
    dr.scatter(flags, mi.ArrayXu([mark.flags() for mark in marks]), lane)
    dr.scatter(depth, mi.ArrayXf([mark.depth for mark in marks]), lane)
    dr.scatter(scale, mi.ArrayXf([mark.scale for mark in marks]), lane)
    dr.eval(flags, depth, scale)
    return Marks((flags & _EMPTY) != 0, (flags & _PARTIAL) != 0, flags & (_PARTIAL - 1), depth, scale)


def find_partly_visible(bank: ViewBank, maps: DistanceMaps, point: Point3f, half_mm: Float, tested: Bool, min_votes: int) -> Bool:
    """Return the mask of nodes for which enough views show a corner, although too few show the centre.

    Such nodes lie at the boundary of the region that too few views show.

    Parameters
    ----------
    bank, maps : ViewBank, DistanceMaps
        Views and their distance maps.
    point : mi.Point3f
        Centres of the nodes.
    half_mm : Float
        Half the edge length of the nodes, mm.
    tested : Bool
        Mask of the nodes to test.
    min_votes : int
        Minimum number of views that must show a corner.

    Returns
    -------
    mi.Bool
        Mask of the partly visible nodes. It is false for nodes that were not tested.
    """
    result = dr.zeros(mi.Bool, dr.width(point))
    chosen = dr.compress(tested)
    if dr.width(chosen) == 0:
        return result
    part = dr.gather(mi.Point3f, point, chosen)
    some, least = dr.zeros(mi.Bool, dr.width(chosen)), dr.opaque(mi.UInt32, min_votes)

    def undecided(view: UInt32, votes: UInt32) -> Bool:
        return (view < bank.end) & (votes < least) & (votes + (bank.end - view) >= least)

    for offset in corners(half_mm):
        at = part + offset

        def body(view: UInt32, votes: UInt32, at: Point3f = at) -> tuple[UInt32, UInt32]:
            usable = distance_maps.project_and_read(bank, maps, view, at, mi.Bool(True))[2]
            return view + 1, votes + dr.select(usable, mi.UInt32(1), mi.UInt32(0))

        state = (mi.UInt32(0), dr.select(some, least, mi.UInt32(0)))
        some |= dr.while_loop(state, undecided, body)[1] >= least
        dr.eval(some)
    dr.scatter(result, some, chosen)
    return result


def corners(half_mm: Float) -> list[Vector3f]:
    """Return the offsets from a node's centre to its eight corners, in the order of the children in `carve`.

    The signs of the coordinates are stored as opaque variables, so that one compiled kernel serves all corners.
    """
    signs = [dr.opaque(mi.Float, sign) for sign in (-1.0, 1.0)]
    return [mi.Vector3f(*(half_mm * signs[c] for c in corner)) for corner in np.ndindex(2, 2, 2)]
