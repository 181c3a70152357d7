"""Solids whose surfaces overlap, such as a coil with touching turns: each part of the volume counts once."""

import manifold3d
import numpy as np

SMALLEST = 1e-5
"""Relative volume of an overlap that is ignored. Rounding errors of thin parts are below 3e-6."""
_MOST_CUTS = 6
"""Maximum number of cuts after which the pieces of a surface must be free of overlaps, two along each axis. One cut
along each of two axes separates the turns of a coil of any length. A tube that is thicker than its bend folds into
itself, so that no number of cuts is sufficient."""


def relative_overlap(solid: manifold3d.Manifold) -> float:
    """Return an upper limit of the relative error of a solid's volume because of parts that overlap or are inside out.

    The volume of an intersection is the integral of the product of both winding numbers w. The integral of w^2 equals
    the volume where w is 0 or 1. Where w is 2 or -1, it exceeds the signed volume by twice the error.
    """
    return max((solid ^ solid).volume() / abs(solid.volume()) - 1.0, 0.0) / 2.0


def unite_overlaps(shell: manifold3d.Manifold) -> manifold3d.Manifold | None:
    """Return the solid of a shell that may intersect itself.

    The shell is cut by planes until no piece intersects itself, and the pieces are united. The result is None if this
    is impossible, because the surface folds into itself or is partly inside out.
    """
    return _unite(shell, 0)


def _unite(piece: manifold3d.Manifold, cuts: int) -> manifold3d.Manifold | None:
    if relative_overlap(piece) <= SMALLEST:
        return piece if piece.volume() > 0.0 else None
    if cuts == _MOST_CUTS:
        return None
    axis = cuts % 3
    low, high = np.reshape(piece.bounding_box(), (2, 3))[:, axis]
    united: list[manifold3d.Manifold] = []
    for half in piece.split_by_plane(tuple(np.eye(3)[axis]), float(low + high) / 2.0):
        for part in half.decompose():
            solid = _unite(part, cuts + 1)
            if solid is None:
                return None
            united.append(solid)
    return manifold3d.Manifold.batch_boolean(united, manifold3d.OpType.Add)
