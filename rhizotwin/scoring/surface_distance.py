"""Exact distances from points to a triangle mesh."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

Floats = NDArray[np.float64]

PAIRS_AT_ONCE = 1_000_000
"""Maximum number of point-triangle pairs in memory at once."""
_SMALL_CLASS = 0.02
"""Minimum number of triangles in a size class, as a fraction of all triangles. A smaller class is merged with the class
of the next larger triangles."""


def point_triangle_distance(p: Floats, a: Floats, b: Floats, c: Floats) -> Floats:
    """Compute the distance from each point to the triangle in the same row.

    See Ericson, Real-Time Collision Detection (2005), section 5.1.5. The distance is the minimum of the distances to
    the three edges, and of the distance to the plane if the foot of the perpendicular lies inside the triangle.

    Parameters
    ----------
    p : (N, 3) array
        Points.
    a, b, c : (N, 3) array
        Vertices of the triangles, one triangle per row.

    Returns
    -------
    (N,) array
        Distances in the unit of the points.
    """

    def to_edge(start: Floats, end: Floats) -> Floats:
        along = end - start
        length2 = np.einsum("ij,ij->i", along, along)
        t = np.einsum("ij,ij->i", p - start, along) / np.where(length2 > 0.0, length2, 1.0)
        away = p - start - np.clip(t, 0.0, 1.0)[:, None] * along
        return np.asarray(np.einsum("ij,ij->i", away, away))

    nearest2 = np.minimum(np.minimum(to_edge(a, b), to_edge(b, c)), to_edge(c, a))
    ab, ac, ap = b - a, c - a, p - a
    d00, d01, d11 = (np.einsum("ij,ij->i", x, y) for x, y in ((ab, ab), (ab, ac), (ac, ac)))
    d20, d21 = np.einsum("ij,ij->i", ap, ab), np.einsum("ij,ij->i", ap, ac)
    det = d00 * d11 - d01 * d01
    v, w = d11 * d20 - d01 * d21, d00 * d21 - d01 * d20
    over = (det > 0.0) & (v >= 0.0) & (w >= 0.0) & (v + w <= det)
    safe = np.where(det > 0.0, det, 1.0)
    foot = ap - (v / safe)[:, None] * ab - (w / safe)[:, None] * ac
    return np.sqrt(np.where(over, np.minimum(nearest2, np.einsum("ij,ij->i", foot, foot)), nearest2))


def distances(points_mm: Floats, vertices_mm: Floats, faces: NDArray[np.integer]) -> Floats:
    """Compute the distance (N,), mm, from each point (N, 3) to a mesh.

    The mesh has vertices (V, 3), mm, and faces (F, 3). Triangles are grouped into classes of similar size, and classes
    with many triangles are processed first. In each class the candidates are the triangles with the nearest centroids.
    The search for a point ends when the distance to the next centroid exceeds the current minimum distance plus the
    largest circumradius of the class, because no triangle farther away can be nearer.
    """
    points_mm = np.asarray(points_mm, np.float64)
    if not len(faces):
        raise ValueError(f"{faces.shape=} but the mesh must have at least one triangle")
    corners = np.asarray(vertices_mm, np.float64)[faces]
    centroids = corners.mean(axis=1)
    radii = np.linalg.norm(corners - centroids[:, None], axis=2).max(axis=1)
    classes = np.round(2.0 * np.log2(np.maximum(radii, 1e-6 * max(float(radii.max()), 1e-300)))).astype(int)
    best = np.full(len(points_mm), np.inf)
    for members in _group_by_size(classes):
        tree = cKDTree(centroids[members])
        _update_distances(best, points_mm, corners[members], tree, float(radii[members].max()))
    return best


def _group_by_size(classes: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    """Group triangles by size class.

    Return the indices (M,) of the triangles in each group, largest group first. A class with few triangles is merged
    with the class of the next larger triangles.
    """
    groups: list[NDArray[np.int64]] = []
    waiting = np.zeros(0, np.int64)
    sizes = np.unique(classes)
    for size in sizes:
        waiting = np.concatenate([waiting, np.flatnonzero(classes == size)])
        if len(waiting) > _SMALL_CLASS * len(classes) or size == sizes[-1]:
            groups.append(waiting)
            waiting = np.zeros(0, np.int64)
    return sorted(groups, key=len, reverse=True)


def _update_distances(best: Floats, points_mm: Floats, corners: Floats, tree: cKDTree, radius_mm: float) -> None:
    """Update the minimum distances ``best`` (N,) in place with a group of triangles (M, 3, 3).

    The circumradius of these triangles is at most ``radius_mm``.
    """
    open_points = np.arange(len(points_mm))
    k = 1 if np.isfinite(best).all() else min(8, len(corners))  # a few nearest centroids are sufficient for most points
    while len(open_points):
        still_open = []
        for start in range(0, len(open_points), max(1, PAIRS_AT_ONCE // k)):
            part = open_points[start : start + max(1, PAIRS_AT_ONCE // k)]
            reach = float(best[part].max()) + radius_mm
            apart, near = tree.query(points_mm[part], k=[1] if k == 1 else k, distance_upper_bound=reach, workers=-1)
            row, column = np.nonzero(apart - radius_mm < best[part][:, None])
            triangle = corners[near[row, column]]
            exact = point_triangle_distance(points_mm[part[row]], triangle[:, 0], triangle[:, 1], triangle[:, 2])
            np.minimum.at(best, part[row], exact)
            still_open.append(part[apart[:, -1] - radius_mm < best[part]])
        if k == len(corners):
            return
        open_points = np.concatenate(still_open)
        k = min(4 * k, len(corners))
