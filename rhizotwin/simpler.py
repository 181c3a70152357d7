"""A surface with fewer triangles, for looking at."""

import numpy as np

from rhizotwin.recon.results.result_files import Mesh


def simpler(mesh: Mesh, most: int) -> Mesh:
    """Return a surface of at most ``most`` triangles: vertices that fall into one cell of a grid become their mean."""
    vertices, faces = mesh.vertices_mm, mesh.faces
    edge = float(np.median(np.linalg.norm(vertices[faces[:1000, 0]] - vertices[faces[:1000, 1]], axis=1)))
    while len(faces) > most:
        edge = 1.3 * max(edge, 1e-6)
        _, number, count = np.unique(np.floor(mesh.vertices_mm / edge).astype(np.int64), axis=0, return_inverse=True, return_counts=True)
        number = number.ravel()
        joined = number[mesh.faces]
        faces = joined[(joined[:, 0] != joined[:, 1]) & (joined[:, 1] != joined[:, 2]) & (joined[:, 2] != joined[:, 0])]
        sums = [np.bincount(number, weights=mesh.vertices_mm[:, axis]) for axis in range(3)]
        vertices = np.stack(sums, axis=1) / count[:, None]
    return Mesh(vertices_mm=vertices, faces=faces)
