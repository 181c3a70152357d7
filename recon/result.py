"""The result of a reconstruction, and writing it as a folder.

RESULT/  result.json   numbers, views, warnings, timings, settings and versions
         shape.npz     leaves (N, 3) lowest corner and size (N,) in voxels, occupancy (N,), origin_mm, voxel_mm
         shape.ply     surface, canister frame, mm
         silhouettes/NAME.png   16 bit: measured coverage of each pixel by roots
         seen/NAME.png          8 bit: 255 where the picture says something about the water
"""

import io
import time
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from recon.silhouettes import Silhouette
from scenes import atomic

SCHEMA_VERSION = 1


@dataclass(frozen=True, kw_only=True)
class ViewResult:
    """What became of one picture."""

    file: str
    ring: int
    used: bool
    reason: str | None = None
    """Why it was left out."""
    cam_from_canister: list[list[float]] | None = None
    reprojection_px: float | None = None
    position_sigma_mm: float | None = None
    """Standard deviation of the camera's centre."""
    rotation_sigma_deg: float | None = None
    markers: int = 0
    table_deg: float | None = None
    fill: float | None = None
    """Fraction of the seen water that roots cover."""


@dataclass(frozen=True, kw_only=True)
class Shape:
    """Occupied voxels and the surface."""

    index: NDArray[np.int32]
    size: NDArray[np.int32]
    occupancy: NDArray[np.float32]
    origin_mm: NDArray[np.float64]
    voxel_mm: float
    mesh: trimesh.Trimesh


@dataclass(frozen=True, kw_only=True)
class Result:
    """Everything a reconstruction found."""

    dataset: str
    scene: str
    voxel_mm: float
    volume_mm3: float
    volume_interval_mm3: tuple[float, float]
    extents_min_mm: tuple[float, ...]
    extents_max_mm: tuple[float, ...]
    blind_mm3: float
    views: tuple[ViewResult, ...]
    warnings: tuple[str, ...]
    timings_s: dict[str, float]
    peak_memory_mib: float
    settings: dict[str, Any]
    versions: dict[str, str]
    shape: Shape = field(repr=False)
    silhouettes: dict[str, Silhouette] = field(repr=False)

    def summary(self) -> dict[str, Any]:
        """Return the content of ``result.json``."""
        numbers = {key: value for key, value in self.__dict__.items() if key not in ("shape", "silhouettes", "views")}
        return {"schema_version": SCHEMA_VERSION, **numbers, "views": [asdict(view) for view in self.views]}


def write(result: Result, folder: Path) -> None:
    """Write a result folder; ``result.json`` comes last, so that a folder with one is whole."""
    begin = time.perf_counter()
    buffer = io.BytesIO()
    shape = result.shape
    np.savez_compressed(
        buffer,
        leaves=shape.index,
        size=shape.size,
        occupancy=shape.occupancy,
        origin_mm=shape.origin_mm,
        voxel_mm=np.float64(shape.voxel_mm),
    )
    (folder / "result.json").unlink(missing_ok=True)
    atomic.write_bytes(folder / "shape.npz", buffer.getvalue())
    atomic.write_bytes(folder / "shape.ply", bytes(trimesh.exchange.ply.export_ply(shape.mesh)))
    for file, silhouette in result.silhouettes.items():
        name = Path(file).stem + ".png"
        atomic.write_image(folder / "silhouettes" / name, np.round(silhouette.coverage * 65535.0).astype(np.uint16))
        atomic.write_image(folder / "seen" / name, silhouette.seen.astype(np.uint8) * 255)
    result.timings_s["write"] = time.perf_counter() - begin
    atomic.write_json(folder / "result.json", result.summary())
