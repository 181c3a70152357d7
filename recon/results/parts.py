"""Contents of a result folder: shapes in memory and as files, paths of pictures, and the version of the schema."""

import io
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import trimesh

Floats = NDArray[np.float64]

Json: TypeAlias = dict[str, Any]
"""JSON object."""
SCHEMA_VERSION = 1
"""Version of ``result.json``. It increases when the meaning of a key changes."""


@dataclass(frozen=True, kw_only=True)
class Leaves:
    """Occupied octree leaves of a shape.

    A leaf extends from ``origin_mm + voxel_mm * low`` to ``origin_mm + voxel_mm * (low + size)``.
    """

    low: NDArray[np.int32]
    """Lowest voxel of each leaf, shape (N, 3)."""
    size: NDArray[np.int32]
    """Edge length of each leaf, shape (N,), in voxels."""
    occupancy: NDArray[np.float32]
    """Occupied fraction of each leaf, shape (N,), 0 to 1."""
    origin_mm: Floats
    voxel_mm: float


@dataclass(frozen=True, kw_only=True)
class Mesh:
    """Triangle mesh in the canister frame."""

    vertices_mm: Floats
    """Positions of the vertices, shape (V, 3), mm."""
    faces: NDArray[np.int64]
    """Vertex indices of each face, shape (F, 3)."""

    @staticmethod
    def of(mesh: "trimesh.Trimesh") -> "Mesh":
        """Create a mesh from the vertices and faces of a trimesh mesh."""
        vertices, faces = np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int64)
        return Mesh(vertices_mm=vertices.reshape(-1, 3), faces=faces.reshape(-1, 3))

    @property
    def corners_mm(self) -> Floats:
        """Positions of the three vertices of each face, shape (3, F, 3), mm."""
        return self.vertices_mm[self.faces.T]

    @property
    def areas_mm2(self) -> Floats:
        """Areas of the faces, shape (F,), mm2."""
        a, b, c = self.corners_mm
        return np.asarray(np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2.0)


def shape_npz(shape: Leaves, hull: Leaves) -> bytes:
    """Return the contents of the file ``shape.npz``."""
    buffer = io.BytesIO()
    np.savez_compressed(
        buffer,
        leaves=shape.low,
        size=shape.size,
        occupancy=shape.occupancy,
        hull_leaves=hull.low,
        hull_size=hull.size,
        hull_occupancy=hull.occupancy,
        origin_mm=shape.origin_mm,
        voxel_mm=np.float64(shape.voxel_mm),
    )
    return buffer.getvalue()


def picture_path(folder: Path, frame_file: str) -> Path:
    """Return the path of the PNG file for a frame in ``folder``, such as ``silhouettes``, ``seen`` or ``masks``."""
    return Path(folder) / f"{PurePosixPath(frame_file).stem}.png"
