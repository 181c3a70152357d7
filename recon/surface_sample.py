"""Uniform sampling of points on the surface of a triangle mesh."""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def sample(vertices_mm: Floats, faces: NDArray[np.integer], *, count: int, rng: np.random.Generator) -> tuple[Floats, NDArray[np.int64]]:
    """Sample points uniformly over the area of a mesh.

    Parameters
    ----------
    vertices_mm, faces : (V, 3), (F, 3) array
        Vertices, mm, and vertex indices of the triangles.
    count : int
        Number of points.
    rng : np.random.Generator
        Random number generator.

    Returns
    -------
    (count, 3), (count,) arrays
        Points, mm, and the index of the face of each point.
    """
    a, b, c = (np.asarray(vertices_mm, np.float64)[faces[:, k]] for k in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    if not len(faces) or not area.sum() > 0.0:
        raise ValueError(f"{faces.shape=} has no area from which points can be sampled")
    # Stratified over the area, so that a small count still covers every part.
    level = (np.arange(count) + rng.random(count)) / count * area.sum()
    chosen = np.minimum(np.searchsorted(np.cumsum(area), level, side="right"), len(faces) - 1)
    u, v = rng.random((2, count))
    outside = u + v > 1.0
    u, v = np.where(outside, 1.0 - u, u)[:, None], np.where(outside, 1.0 - v, v)[:, None]
    return np.asarray(a[chosen] + u * (b - a)[chosen] + v * (c - a)[chosen]), chosen
