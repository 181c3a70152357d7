"""Conversion of PLY, STL and OBJ files to one solid, with repair of common defects."""

from collections import Counter
from pathlib import Path

import manifold3d
import numpy as np
import trimesh
from numpy.typing import NDArray

from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.reading import MOST_MESH_MIB, check_size
from rhizotwin.sim.solids import Array, Faces, to_manifold

SUFFIXES = (".ply", ".stl", ".obj")
MOST_FACES = 1_500_000
"""Maximum number of faces: 1.3 million took 1.1 GiB and 32 s without progress. On a sphere of 20 mm, their edges are
0.04 mm long."""
LEAST_MM = 0.5
"""Minimum size of a specimen; smaller ones are probably not in millimetres."""


def load_solid(path: Path) -> tuple[manifold3d.Manifold, list[str]]:
    """Read a closed surface and return it as a solid, with notes on repairs.

    Overlapping shells are united; inner shells with inward normals are cavities; a surface that is entirely inside out
    is inverted, with a note.

    Parameters
    ----------
    path : path
        PLY, STL or OBJ file, in millimetres in the canister frame.

    Raises
    ------
    UserError
        If the file is missing, unreadable, empty, not closed (with the number of open edges), inconsistently oriented,
        or flat.
    """
    vertices, faces = _read(path)
    if len(vertices) == 0 or len(faces) == 0:
        raise UserError(f"{path}: the mesh is empty; export the specimen's closed surface again.")
    if not np.all(np.isfinite(vertices)):
        raise UserError(f"{path}: some coordinates are not finite numbers; export the mesh again.")
    size_mm = float(np.max(np.ptp(vertices[faces.ravel()], axis=0)))
    if size_mm < LEAST_MM:
        raise UserError(f"{path}: the specimen is only {size_mm:.3g} mm across; files must be in millimetres, so scale it up.")
    notes: list[str] = []
    vertices, faces = _join(path, vertices, faces, notes)
    solid = to_manifold(vertices, faces)
    if solid.status() != manifold3d.Error.NoError:
        raise UserError(f"{path}: the surface does not bound a solid ({solid.status().name}); repair it in a mesh editor.")
    solid = _unite_shells(solid, path, notes)
    if solid.is_empty() or solid.volume() <= 0.0:
        raise UserError(f"{path}: the surface encloses no volume; export the specimen's closed surface again.")
    return solid, notes


def _read(path: Path) -> tuple[Array, Faces]:
    """Return vertices (V, 3) and faces (F, 3) of the file."""
    if path.suffix.lower() not in SUFFIXES:
        raise UserError(f"{path}: a specimen must be a PLY, STL or OBJ mesh, or traced roots in a .rsml file, not '{path.suffix}'.")
    if not path.is_file():
        raise UserError(f"{path}: there is no such file; check the path of the specimen's mesh.")
    check_size(path, path.stat(), most_mib=MOST_MESH_MIB)
    try:
        mesh = trimesh.load_mesh(str(path), process=False)
        vertices, faces = np.asarray(mesh.vertices, np.float64).reshape(-1, 3), np.asarray(mesh.faces, np.int64).reshape(-1, 3)
    except Exception as error:  # readers raise various exceptions for invalid bytes
        raise UserError(f"{path}: cannot be read as a {path.suffix[1:].upper()} mesh ({type(error).__name__}); export it again.") from error
    if len(faces) > MOST_FACES:
        raise UserError(f"{path}: has {len(faces)} triangles, more than the maximum of {MOST_FACES}; simplify it first.")
    if len(faces) and (faces.min() < 0 or faces.max() >= len(vertices)):
        raise UserError(f"{path}: faces refer to vertices that the file does not have; it is damaged, export it again.")
    return vertices, faces.astype(np.int32)


def open_edges(faces: NDArray[np.int32]) -> int:
    """Count the edges of triangles (F, 3) that are not used equally often in both directions."""
    a, b = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    keys, inverse = np.unique(np.stack([np.minimum(a, b), np.maximum(a, b)], axis=1), axis=0, return_inverse=True)
    balance = np.bincount(inverse.ravel(), weights=np.where(a < b, 1.0, -1.0), minlength=len(keys))
    return int(np.count_nonzero(balance))


def _single_edges(faces: NDArray[np.int32]) -> int:
    """Count the edges that belong to an odd number of faces, ignoring orientation."""
    edges = np.sort(np.stack([faces.ravel(), np.roll(faces, -1, axis=1).ravel()], axis=1), axis=1)
    counts = np.unique(edges, axis=0, return_counts=True)[1]
    return int(np.count_nonzero(counts % 2))


def _join(path: Path, vertices: Array, faces: Faces, notes: list[str]) -> tuple[Array, Faces]:
    """Return the surface with shared vertices, as indexed in the file, or merged by coordinates (STL, seams of OBJ)."""
    indexed = faces[_proper(faces)]
    if len(indexed) and open_edges(indexed) == 0 and to_manifold(vertices, indexed).status() == manifold3d.Error.NoError:
        return vertices, indexed
    for digits in (None, 5):  # exactly equal, then to 1e-5 mm, as text files round
        rounded = vertices if digits is None else np.round(vertices, digits)
        unique, inverse = np.unique(rounded, axis=0, return_inverse=True)
        joined = inverse.ravel()[faces].astype(np.int32)
        joined = joined[_proper(joined)]
        if len(joined) and _single_edges(joined) == 0:
            break
    if len(joined) == 0:
        raise UserError(f"{path}: every face of the mesh is degenerate; export it again.")
    missing = _single_edges(joined)
    if missing:
        raise UserError(f"{path}: the surface is not closed: {missing} edges have only one face; close the holes in a mesh editor.")
    if open_edges(joined):
        mesh = trimesh.Trimesh(unique, joined, process=False)
        trimesh.repair.fix_winding(mesh)
        joined = np.asarray(mesh.faces, dtype=np.int32)
        if open_edges(joined):
            raise UserError(
                f"{path}: the faces are inconsistently oriented at {open_edges(joined)} edges; recompute its normals in a mesh editor."
            )
        notes.append(f"{path}: faces with an inconsistent orientation were inverted.")
    return unique, joined


def _proper(faces: Faces) -> NDArray[np.bool_]:
    """Return which faces have three different corners."""
    return (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])


def _unite_shells(solid: manifold3d.Manifold, path: Path, notes: list[str]) -> manifold3d.Manifold:
    """Unite overlapping shells, keep cavities, and invert shells that are inside out."""
    kinds: Counter[str] = Counter()
    bodies: list[manifold3d.Manifold] = []
    inverted: list[manifold3d.Manifold] = []
    for shell in solid.decompose():
        if shell.volume() > 0.0:
            bodies.append(shell)
        elif shell.volume() < 0.0:
            vertices, faces = np.array(shell.to_mesh64().vert_properties[:, :3]), np.array(shell.to_mesh64().tri_verts)
            inverted.append(to_manifold(vertices, faces[:, ::-1].astype(np.int32)))
    united = manifold3d.Manifold.batch_boolean(bodies, manifold3d.OpType.Add) if bodies else manifold3d.Manifold()
    for shell in inverted:
        inside = (united ^ shell).volume() > 0.999 * shell.volume()
        united = united - shell if inside else united + shell
        kinds["cavity" if inside else "turned"] += 1
    if kinds["turned"]:
        notes.append(f"{path}: {kinds['turned']} shell(s) were inside out and have been inverted.")
    if kinds["cavity"]:
        notes.append(f"{path}: {kinds['cavity']} closed cavity or cavities inside the specimen are kept as water.")
    if len(bodies) > 1:
        notes.append(f"{path}: {len(bodies)} separate shells were united; the volume counts overlaps once.")
    return united
