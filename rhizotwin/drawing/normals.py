"""Normals of triangle meshes."""

import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.results.parts import Mesh

Floats = NDArray[np.float64]


def vertex_normals(mesh: Mesh) -> Floats:
    """Return the outward normals (V, 3) of the vertices.

    The normal of a vertex is the sum of the area vectors of its triangles, and does not have unit length. Their
    orientation makes the signed volume of the mesh positive.
    """
    a, b, c = mesh.corners_mm
    area = np.cross(b - a, c - a)
    if np.einsum("ij,ij->", a - mesh.vertices_mm.mean(axis=0), area) < 0.0:
        area = -area
    count = len(mesh.vertices_mm)
    return np.stack([np.bincount(mesh.faces.ravel(), weights=np.repeat(area[:, k], 3), minlength=count) for k in range(3)], axis=1)


def unit_normals(mesh: Mesh) -> Floats:
    """Return the outward unit normals (V, 3) of the vertices.

    The normal of a vertex without triangles is zero.
    """
    normals = vertex_normals(mesh)
    return np.asarray(normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12))
