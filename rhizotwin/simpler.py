"""A surface with fewer triangles, for looking at."""

import numpy as np

from rhizotwin.recon.results.parts import Mesh

_SOONER = 0.9
"""A grid's cell begins at this share of the edge that should do, so that the first that does is hardly too coarse."""
_COARSER = 1.15
_MOST_CELLS = 2_000_000
"""To a side: their numbers then stay below 2^63."""


def simpler(mesh: Mesh, most: int) -> Mesh:
    """Return a surface of at most ``most`` triangles: vertices that fall into one cell of a grid become their mean.

    Triangles of a closed surface are as many as its area over the square of their edge, whatever the mesh.
    """
    vertices, faces = mesh.vertices_mm, mesh.faces
    if len(faces) <= most:
        return mesh
    some = faces[:: max(1, len(faces) // 1000)]
    edge = float(np.median(np.linalg.norm(vertices[some[:, 0]] - vertices[some[:, 1]], axis=1)))
    low, span_mm = vertices.min(axis=0), float(np.ptp(vertices, axis=0).max())
    edge = max(edge * _SOONER * (len(faces) / most) ** 0.5, span_mm / _MOST_CELLS)
    while True:
        cell = ((vertices - low) / edge).astype(np.int64)
        _, number = np.unique(np.ravel_multi_index(cell.T, cell.max(axis=0) + 1), return_inverse=True)
        joined = number.astype(np.int32)[faces]
        joined = joined[(joined[:, 0] != joined[:, 1]) & (joined[:, 1] != joined[:, 2]) & (joined[:, 2] != joined[:, 0])]
        if len(joined) <= most:
            break
        edge *= _COARSER
    count = np.bincount(number)
    middle = np.stack([np.bincount(number, weights=vertices[:, axis]) for axis in range(3)], axis=1) / count[:, None]
    return Mesh(vertices_mm=middle, faces=joined.astype(np.int64))
