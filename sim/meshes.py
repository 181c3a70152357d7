"""Read PLY, STL and OBJ files as a solid, and repair common defects of the mesh."""

from collections import Counter
from pathlib import Path

import manifold3d
import numpy as np
import trimesh
from numpy.typing import NDArray

from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.formatting import count, was
from rhizotwin.scenes.reading import MOST_MESH_MIB, check_size
from rhizotwin.sim.overlaps import SMALLEST, relative_overlap, unite_overlaps
from rhizotwin.sim.solids import Array, Faces, invert, to_manifold

SUFFIXES = (".ply", ".stl", ".obj")
"""Supported file name extensions."""
MOST_FACES = 1_500_000
"""Maximum number of faces. Reading a mesh of 1.3 million faces took 1.1 GiB and 32 s, during which no progress is
reported. With so many faces, a sphere of 20 mm has edges of 0.04 mm."""
LEAST_MM = 0.5
"""Minimum size of a specimen, mm. The unit of smaller meshes is probably not the millimetre."""


_LARGEST_OVERLAP = 1e-3
"""Relative error of the volume up to which a surface that folds into itself is accepted. Surfaces from tomography often
have such small folds."""


def load_solid(path: Path) -> tuple[manifold3d.Manifold, list[str]]:
    """Read a closed surface and return the solid that it bounds, together with notes on repairs.

    Overlapping shells, and parts of a shell that overlap, are united. Inner shells with inward normals are cavities. A
    surface whose normals all point inwards is inverted, with a note.

    Parameters
    ----------
    path : path
        PLY, STL or OBJ file, mm, canister frame.

    Raises
    ------
    UserError
        If the file is missing, unreadable or empty, or the surface is not closed (with the number of open edges),
        inconsistently oriented or flat, or folds into itself.
    """
    vertices, faces = _read(path)
    if len(vertices) == 0 or len(faces) == 0:
        raise UserError(f"{path}: the mesh is empty; export the closed surface of the specimen again.")
    if not np.all(np.isfinite(vertices)):
        raise UserError(f"{path}: some coordinates are not finite numbers; export the mesh again.")
    size_mm = float(np.max(np.ptp(vertices[faces.ravel()], axis=0)))
    if size_mm < LEAST_MM:
        raise UserError(
            f"{path}: the specimen has a size of only {size_mm:.3g} mm; its coordinates must be in millimetres; scale the mesh."
        )
    notes: list[str] = []
    vertices, faces = _merge_vertices(path, vertices, faces, notes)
    solid = to_manifold(vertices, faces)
    if solid.status() != manifold3d.Error.NoError:
        raise UserError(f"{path}: the surface does not bound a solid ({solid.status().name}); repair it in a mesh editor.")
    solid = _unite_shells(solid, path, notes)
    if solid.is_empty() or solid.volume() <= 0.0:
        raise UserError(f"{path}: the surface encloses no volume; export the closed surface of the specimen again.")
    return solid, notes


def _read(path: Path) -> tuple[Array, Faces]:
    """Read the vertices (V, 3), mm, and the faces (F, 3) of a mesh file."""
    if path.suffix.lower() not in SUFFIXES:
        raise UserError(
            f"{path}: the extension '{path.suffix}' is not supported; the file must be a mesh (.ply, .stl, .obj) or traced roots (.rsml)."
        )
    if not path.is_file():
        raise UserError(f"{path}: the file does not exist; check the path of the specimen's mesh.")
    check_size(path, path.stat(), most_mib=MOST_MESH_MIB)
    try:
        mesh = trimesh.load_mesh(str(path), process=False)
        vertices, faces = np.asarray(mesh.vertices, np.float64).reshape(-1, 3), np.asarray(mesh.faces, np.int64).reshape(-1, 3)
    except Exception as error:  # readers raise various exceptions for invalid bytes
        raise UserError(
            f"{path}: the file could not be read as a {path.suffix[1:].upper()} mesh ({type(error).__name__}); export the mesh again."
        ) from error
    if len(faces) > MOST_FACES:
        raise UserError(f"{path}: the mesh has {len(faces)} triangles, but at most {MOST_FACES} are supported; simplify it.")
    if len(faces) and (faces.min() < 0 or faces.max() >= len(vertices)):
        raise UserError(f"{path}: the file is damaged, because faces refer to missing vertices; export the mesh again.")
    return vertices, faces.astype(np.int32)


def open_edges(faces: NDArray[np.int32]) -> int:
    """Count the edges at which triangles (F, 3) do not form a closed surface with a consistent orientation.

    In such a surface, each edge is used equally often in both directions.
    """
    a, b = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    keys, inverse = np.unique(np.stack([np.minimum(a, b), np.maximum(a, b)], axis=1), axis=0, return_inverse=True)
    balance = np.bincount(inverse.ravel(), weights=np.where(a < b, 1.0, -1.0), minlength=len(keys))
    return int(np.count_nonzero(balance))


def _single_edges(faces: NDArray[np.int32]) -> int:
    """Count the edges that belong to an odd number of triangles (F, 3).

    The orientation of the triangles is ignored.
    """
    edges = np.sort(np.stack([faces.ravel(), np.roll(faces, -1, axis=1).ravel()], axis=1), axis=1)
    counts = np.unique(edges, axis=0, return_counts=True)[1]
    return int(np.count_nonzero(counts % 2))


def _merge_vertices(path: Path, vertices: Array, faces: Faces, notes: list[str]) -> tuple[Array, Faces]:
    """Merge vertices at the same position, so that neighbouring faces share them.

    Merging is necessary for STL files, and at texture seams of OBJ files. Vertices are not merged if the surface in the
    file is already closed.
    """
    indexed = faces[_is_proper(faces)]
    if len(indexed) and open_edges(indexed) == 0 and to_manifold(vertices, indexed).status() == manifold3d.Error.NoError:
        return vertices, indexed
    for digits in (None, 5):  # exactly equal, then equal to 1e-5 mm because of rounding in text files
        rounded = vertices if digits is None else np.round(vertices, digits)
        unique, inverse = np.unique(rounded, axis=0, return_inverse=True)
        joined = inverse.ravel()[faces].astype(np.int32)
        joined = joined[_is_proper(joined)]
        if len(joined) and _single_edges(joined) == 0:
            break
    if len(joined) == 0:
        raise UserError(f"{path}: all faces of the mesh are degenerate; export the mesh again.")
    missing = _single_edges(joined)
    if missing:
        raise UserError(f"{path}: the surface is not closed at {count(missing, 'edge')}; close the holes in a mesh editor.")
    if open_edges(joined):
        mesh = trimesh.Trimesh(unique, joined, process=False)
        trimesh.repair.fix_winding(mesh)
        joined = np.asarray(mesh.faces, dtype=np.int32)
        if open_edges(joined):
            raise UserError(
                f"{path}: the faces at {count(open_edges(joined), 'edge')} are inconsistently oriented; "
                "recompute the normals in a mesh editor."
            )
        notes.append(f"{path}: faces with an inconsistent orientation were inverted.")
    return unique, joined


def _is_proper(faces: Faces) -> NDArray[np.bool_]:
    """Return whether the three vertices of each face differ (F,)."""
    return (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])


def _unite_shells(solid: manifold3d.Manifold, path: Path, notes: list[str]) -> manifold3d.Manifold:
    """Unite overlapping shells.

    Cavities are kept, and shells whose normals point inwards are inverted.
    """
    kinds: Counter[str] = Counter()
    bodies: list[manifold3d.Manifold] = []
    inverted: list[manifold3d.Manifold] = []
    for shell in solid.decompose():
        if shell.volume() > 0.0:
            bodies.append(_count_once(shell, path, notes))
        elif shell.volume() < 0.0:
            inverted.append(_count_once(invert(shell), path, notes))
    united = manifold3d.Manifold.batch_boolean(bodies, manifold3d.OpType.Add)
    for shell in inverted:
        inside = (united ^ shell).volume() > 0.999 * shell.volume()
        united = united - shell if inside else united + shell
        kinds["cavity" if inside else "turned"] += 1
    if kinds["turned"]:
        notes.append(f"{path}: {count(kinds['turned'], 'shell')} with normals that pointed inwards {was(kinds['turned'])} inverted.")
    if kinds["cavity"]:
        cavities = count(kinds["cavity"], "closed cavity", "closed cavities")
        notes.append(f"{path}: {cavities} inside the specimen {was(kinds['cavity'])} kept and filled with water.")
    if len(bodies) > 1:
        notes.append(f"{path}: {len(bodies)} separate shells were united; overlaps are counted once in the volume.")
    return united


def _count_once(shell: manifold3d.Manifold, path: Path, notes: list[str]) -> manifold3d.Manifold:
    """Return a shell in which parts that overlap count once in the volume."""
    overlap = relative_overlap(shell)
    if overlap <= SMALLEST:
        return shell
    united = unite_overlaps(shell)
    if united is not None:
        notes.append(f"{path}: a surface intersects itself; overlaps are counted once in the volume.")
        return united
    if overlap > _LARGEST_OVERLAP:
        raise UserError(
            f"{path}: the surface folds into itself, so that its volume is uncertain by {100.0 * overlap:.2g} %; "
            "remesh it with voxels in a mesh editor, or specify the centre lines as RSML."
        )
    notes.append(f"{path}: the surface folds into itself; the error of its volume is at most {100.0 * overlap:.2g} %.")
    return shell
