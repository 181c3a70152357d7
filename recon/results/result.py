"""The result of a reconstruction, and writing it as a folder.

RESULT/  result.json   numbers, traits, views, rig, warnings, timings, settings and versions
shape.npz     leaves (N, 3) lowest corner and size (N,) in voxels, occupancy (N,); the same of the untrimmed hull as
hull_leaves, hull_size, hull_occupancy; origin_mm (3,), voxel_mm
shape.ply     surface, canister frame, mm
roots.rsml    centre lines and diameters of the roots, where some were found
traits.csv, traits.json   traits with units and definitions
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

from rhizotwin.recon.coverage.silhouettes import Silhouette
from rhizotwin.recon.results import result_traits
from rhizotwin.recon.results.result_files import SCHEMA_VERSION, picture_path
from rhizotwin.recon.uncertainty.budget import Budget
from rhizotwin.scenes import atomic, rsml
from rhizotwin.scenes.rsml import Root
from rhizotwin.scenes.schema import to_plain
from rhizotwin.scenes.traits import Traits

Triple = tuple[float, float, float]


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


@dataclass(frozen=True)
class Voxels:
    """Occupied cubes of one or more voxels; they do not overlap."""

    index: NDArray[np.int32]
    """(N, 3) lowest corner, in voxels."""
    size: NDArray[np.int32]
    """(N,) edge, in voxels."""
    occupancy: NDArray[np.float32]
    """(N,) fraction inside."""


@dataclass(frozen=True, kw_only=True)
class Shape:
    """What stands in the water, and how large it is."""

    voxels: Voxels
    hull: Voxels
    """The same before trimming."""
    origin_mm: NDArray[np.float64]
    voxel_mm: float
    finest_mm: float
    """Edge of the nodes that were carved."""
    mesh: trimesh.Trimesh
    budget: Budget
    """The volume, and how far it can be trusted."""
    volume_bounds_mm3: tuple[float, float]
    """Smallest and largest volume that the silhouettes allow."""
    hull_mm3: float
    untrimmed_mm3: float
    """Part of the volume that is hull still."""
    blind_mm3: float
    """Volume of the water that too few views see."""
    extents_min_mm: Triple
    extents_max_mm: Triple
    mu_per_mm: float | None = None
    """Attenuation of light in the roots; None for opaque ones, and where nobody asked."""
    mu_sigma_per_mm: float | None = None
    """Its standard deviation, where thin roots told it."""
    roots: tuple[Root, ...] = ()
    """Centre lines and diameters, parents before children; empty where there are none."""

    @property
    def volume_mm3(self) -> float:
        """Return the volume."""
        return self.budget.volume_mm3

    @property
    def length_mm(self) -> float:
        """Return the total length of the roots."""
        return float(sum(np.linalg.norm(np.diff(root.points_mm, axis=0), axis=1).sum() for root in self.roots))


@dataclass(frozen=True, kw_only=True)
class Result:
    """Everything a reconstruction found."""

    dataset: str
    dataset_sha256: str
    """Of the dataset's manifest, which holds the hashes of its pictures."""
    scene: str
    shape: Shape
    mass_g: float | None = None
    """Of the roots, where they were weighed."""
    views: tuple[ViewResult, ...]
    rig: dict[str, Any]
    """Cameras, seat and errors that all views together gave; empty where the poses were given."""
    warnings: tuple[str, ...]
    timings_s: dict[str, float]
    peak_memory_mib: float
    settings: dict[str, Any]
    versions: dict[str, str]
    silhouettes: dict[str, Silhouette] = field(repr=False)
    """By the frame's file."""

    def traits(self) -> Traits:
        """Measure the traits."""
        shape = self.shape
        return result_traits.of_shape(
            np.asarray(shape.mesh.vertices, np.float64),
            np.asarray(shape.mesh.faces, np.int64),
            shape.roots,
            volume_mm3=shape.volume_mm3,
            finest_mm=shape.finest_mm,
            mass_g=self.mass_g,
            extents_mm=(shape.extents_min_mm, shape.extents_max_mm),
        )

    def summary(self) -> dict[str, Any]:
        """Return the content of ``result.json``, without the traits."""
        shape = self.shape
        return {
            "schema_version": SCHEMA_VERSION,
            "dataset": self.dataset,
            "dataset_sha256": self.dataset_sha256,
            "scene": self.scene,
            "voxel_mm": shape.voxel_mm,
            "volume_mm3": shape.volume_mm3,
            "volume_interval_mm3": shape.budget.interval_mm3,
            "volume_bounds_mm3": shape.volume_bounds_mm3,
            "volume_trusted": not shape.budget.doubts,
            "volume_verdict": shape.budget.verdict,
            "volume_budget": [asdict(term) for term in shape.budget.terms],
            "hull_mm3": shape.hull_mm3,
            "untrimmed_mm3": shape.untrimmed_mm3,
            "blind_mm3": shape.blind_mm3,
            "root_mu_per_mm": shape.mu_per_mm,
            "root_mu_sigma_per_mm": shape.mu_sigma_per_mm,
            "length_mm": shape.length_mm,
            "tips": sum(root.tip_seen for root in shape.roots),
            "mass_g": self.mass_g,
            "extents_min_mm": shape.extents_min_mm,
            "extents_max_mm": shape.extents_max_mm,
            "views": [asdict(view) for view in self.views],
            "rig": self.rig,
            "warnings": list(self.warnings),
            "timings_s": self.timings_s,
            "peak_memory_mib": self.peak_memory_mib,
            "settings": self.settings,
            "versions": self.versions,
        }


def write(result: Result, folder: Path) -> None:
    """Write a result folder; ``result.json`` comes last, so that a folder with one is whole."""
    begin = time.perf_counter()
    buffer, shape = io.BytesIO(), result.shape
    np.savez_compressed(
        buffer,
        leaves=shape.voxels.index,
        size=shape.voxels.size,
        occupancy=shape.voxels.occupancy,
        hull_leaves=shape.hull.index,
        hull_size=shape.hull.size,
        hull_occupancy=shape.hull.occupancy,
        origin_mm=shape.origin_mm,
        voxel_mm=np.float64(shape.voxel_mm),
    )
    (folder / "result.json").unlink(missing_ok=True)
    atomic.write_bytes(folder / "shape.npz", buffer.getvalue())
    atomic.write_bytes(folder / "shape.ply", bytes(trimesh.exchange.ply.export_ply(shape.mesh)))
    (folder / "roots.rsml").unlink(missing_ok=True)
    if shape.roots:
        rsml.write_rsml(folder / "roots.rsml", shape.roots)
    for file, silhouette in result.silhouettes.items():
        atomic.write_image(picture_path(folder / "silhouettes", file), np.round(silhouette.coverage * 65535.0).astype(np.uint16))
        atomic.write_image(picture_path(folder / "seen", file), silhouette.seen.astype(np.uint8) * 255)
    traits = result.traits()
    for name, text in result_traits.as_text(traits, result.summary(), mass_g=result.mass_g).items():
        atomic.write_text(folder / name, text)
    result.timings_s["write"] = time.perf_counter() - begin
    atomic.write_json(folder / "result.json", result.summary() | {"traits": to_plain(traits)})
