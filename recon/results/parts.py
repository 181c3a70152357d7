"""Parts of a result folder: shapes in memory and packed, names of pictures, and version."""

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
"""Version of ``result.json``; it increases when the meaning of a key changes."""


@dataclass(frozen=True, kw_only=True)
class Leaves:
    """Occupied leaves of the octree: a leaf covers ``origin_mm + voxel_mm * [low, low + size]``."""

    low: NDArray[np.int32]
    """(N, 3) lowest voxel."""
    size: NDArray[np.int32]
    """(N,) edge length in voxels."""
    occupancy: NDArray[np.float32]
    """(N,) occupied fraction of the leaf, 0..1."""
    origin_mm: Floats
    voxel_mm: float


@dataclass(frozen=True, kw_only=True)
class Mesh:
    """A triangle mesh in the canister frame."""

    vertices_mm: Floats
    """(V, 3) vertices."""
    faces: NDArray[np.int64]
    """(F, 3) vertex indices."""

    @staticmethod
    def of(mesh: "trimesh.Trimesh") -> "Mesh":
        """Return the vertices and faces of a trimesh mesh."""
        vertices, faces = np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int64)
        return Mesh(vertices_mm=vertices.reshape(-1, 3), faces=faces.reshape(-1, 3))

    @property
    def corners_mm(self) -> Floats:
        """First, second and third vertex of the faces (3, F, 3)."""
        return self.vertices_mm[self.faces.T]

    @property
    def areas_mm2(self) -> Floats:
        """Areas of the faces (F,)."""
        a, b, c = self.corners_mm
        return np.asarray(np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2.0)


def shape_npz(shape: Leaves, hull: Leaves) -> bytes:
    """Return the contents of ``shape.npz``."""
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
    """Return the path of a frame's picture in ``folder`` (silhouettes, seen, masks), always as PNG."""
    return Path(folder) / f"{PurePosixPath(frame_file).stem}.png"
