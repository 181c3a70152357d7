"""Result of a reconstruction, and its storage as a folder.

    RESULT/  result.json           numbers, traits, views, rig, warnings, timings, settings and versions
             shape.npz             octree leaves of the shape in voxels: lowest corners leaves (N, 3), edges size (N,)
                                   and occupancy (N,); the same for the untrimmed hull: hull_leaves, hull_size and
                                   hull_occupancy; also origin_mm (3,) and voxel_mm
             shape.ply             surface, canister frame, mm
             shoot.ply             surface of the shoot's visual hull, if there are pictures of a shoot
             roots.rsml            centre lines and diameters of the roots, if any were found
             roots.csv             length, diameters, parent, order and place of each of these roots
             leaves.csv            area and colour of each leaf, if there is a shoot
             traits.csv, .json     traits with units and definitions
             silhouettes/NAME.png  16 bit: measured fraction of each pixel that roots cover
             seen/NAME.png         8 bit: 255 for usable pixels, 0 for all others

NAME is the name of the picture in the dataset.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from rhizotwin.recon.calibration.cameras import Camera
from rhizotwin.recon.coverage.silhouettes import Silhouette
from rhizotwin.recon.results import assessments, result_traits
from rhizotwin.recon.results.by_plant import PlantResult
from rhizotwin.recon.results.parts import SCHEMA_VERSION, Json, Leaves, Mesh, picture_path, shape_npz
from rhizotwin.recon.shoots.shoot import Shoot
from rhizotwin.recon.uncertainty.budget import Volume
from rhizotwin.recon.uncertainty.checks import Check, Estimate
from rhizotwin.scenes import atomic, rsml, trait_table
from rhizotwin.scenes.formatting import interval_ml, ml
from rhizotwin.scenes.model import MarkerStrip
from rhizotwin.scenes.rsml import Root
from rhizotwin.scenes.schema import to_plain
from rhizotwin.scenes.solution import Solution
from rhizotwin.scenes.subject import Subject
from rhizotwin.scenes.traits import Traits

Triple = tuple[float, float, float]


def triple(values: NDArray[np.float64]) -> Triple:
    """Convert an array of three numbers (3,) to a tuple."""
    x, y, z = (float(value) for value in values)
    return x, y, z


POSES = ("cam_from_canister", "cam_from_tank")
"""Keys of a camera's poses in ``result.json``."""
_VIEW_KEYS = ("file", "ring", "used", "reason", *POSES, "sway", "reprojection_px", "position_sigma_mm", "rotation_sigma_deg", "sha256")
"""Keys of a camera in ``result.json``, besides those that describe its markers, its table angle and its silhouette."""


@dataclass(frozen=True, kw_only=True)
class Solid:
    """Reconstructed solid and its volume."""

    voxels: Leaves
    """Occupied, non-overlapping cubes of one or more voxels."""
    hull: Leaves
    """Occupied cubes of the visual hull, before trimming."""
    finest_mm: float
    """Edge length of the smallest carved octree nodes, mm."""
    mesh: trimesh.Trimesh
    """Surface in the canister frame, mm."""
    volume: Volume
    hull_mm3: float
    untrimmed_mm3: float
    """Part of the volume that was not trimmed, mm3."""
    blind_mm3: float
    """Volume of the water that too few views show, mm3."""
    hidden_mm: float = 0.0
    """Maximum length of the roots that the net pot hides, mm (`uncertainty.hidden_top`)."""
    hidden_height_mm: float = 0.0
    """Maximum height of the roots that the net pot hides, mm."""
    extents_min_mm: Triple
    extents_max_mm: Triple
    mu_per_mm: float | None = None
    """Attenuation coefficient of the roots, 1/mm, or None if they are opaque or the coefficient was not measured."""
    mu_sigma_per_mm: float | None = None
    """Standard deviation of the attenuation coefficient, 1/mm, or None if it could not be estimated from thin roots."""
    roots: tuple[Root, ...] = ()
    """Centre lines and diameters of the roots. Parents come before children. Empty if there are no roots."""
    nodules: tuple[Root, ...] = ()
    """Centre lines and diameters of nodules and other swellings, which are not roots."""
    warnings: tuple[str, ...] = ()
    checks: tuple[Check, ...] = ()
    """Checks of the consistency between the views and the shape."""

    @property
    def voxel_mm(self) -> float:
        """Edge length of a voxel, mm."""
        return self.voxels.voxel_mm

    @property
    def surface(self) -> Mesh:
        """Surface as an array of vertices and an array of faces."""
        return Mesh.of(self.mesh)

    @property
    def length_mm(self) -> float:
        """Total length of the roots, mm."""
        return rsml.length_mm(self.roots)


@dataclass(frozen=True, kw_only=True)
class Result:
    """Complete result of a reconstruction.

    The method `save` writes it to a folder, from which `rhizotwin.load_result` reads it.
    """

    dataset: str
    """Folder of the dataset."""
    dataset_sha256: str
    """SHA-256 hash of the dataset's manifest, which contains the hashes of its pictures."""
    scene: str
    solid: Solid
    subject: Subject = Subject()
    """Plant, as specified in the dataset."""
    solution: Solution = field(default_factory=Solution)
    """Nutrient solution, as specified in the dataset."""
    plants: tuple[PlantResult, ...] = ()
    """Results of the individual plants, if there are several. Empty for a single plant or without roots."""
    strip: MarkerStrip | None = None
    """Marker strip, which defines the canister frame. None in results of earlier versions."""
    mass_g: float | None = None
    """Fresh mass of the roots, g, or None if they were not weighed."""
    cameras: tuple[Camera, ...]
    """Cameras of all pictures of the roots."""
    shoot: Shoot | None = None
    """Shoot above the net pot, or None if no picture shows it."""
    edits: Json | None = None
    """Summary of the manual corrections, or None if the result was not corrected."""
    bands: Mapping[str, float] = field(default_factory=dict)
    """Signal-to-noise ratio of the roots in each band of the camera, starting with the band that was used. Empty if the
    camera has no bands, or if the band is specified in the settings."""
    fill: Mapping[str, float]
    """Fraction of the usable pixels that roots cover, keyed by the file name of the frame."""
    rig: Json
    """Calibration of cameras and canister from all views. It is empty if the dataset specifies the poses."""
    warnings: tuple[str, ...]
    checks: tuple[Check, ...] = ()
    """Checks that determine whether the volume is reliable."""
    estimates: tuple[Estimate, ...] = ()
    """Length, number of tips and mean diameter, each with an interval and a verdict. Empty if there are no roots."""
    timings_s: dict[str, float]
    """Duration of each stage, s."""
    passes: Mapping[str, int] = field(default_factory=dict)
    """Number of passes over all pictures, keyed by their kind (`recon.passes`). Empty in results of earlier
    versions."""
    peak_memory_mib: float
    settings: Json
    versions: dict[str, str]
    silhouettes: Mapping[str, Silhouette] = field(repr=False)
    """Silhouettes, keyed by the file name of the frame. Empty if a stored result contains none."""
    notebook: Callable[[Result], str] | None = field(default=None, repr=False, compare=False)
    """Function that returns the HTML representation in notebooks. It is set by the public API."""

    @property
    def volume_mm3(self) -> float:
        """Reconstructed volume, mm3."""
        return self.solid.volume.mm3

    @property
    def interval_mm3(self) -> tuple[float, float]:
        """90 % interval of the volume, mm3."""
        return self.solid.volume.interval_mm3

    @property
    def trusted(self) -> bool:
        """Whether the volume is reliable."""
        return self.solid.volume.trusted

    @property
    def verdict(self) -> str:
        """Reliability of the volume, in one sentence."""
        return self.solid.volume.verdict

    @property
    def roots(self) -> tuple[Root, ...]:
        """Centre lines and diameters of the roots. Parents come before children. Empty if there are no roots."""
        return self.solid.roots

    @cached_property
    def measured(self) -> Traits:
        """Traits measured on the reconstructed surface and roots."""
        solid = self.solid
        return result_traits.measure_shape(
            solid.surface,
            solid.roots,
            volume_mm3=solid.volume.mm3,
            finest_mm=solid.finest_mm,
            mass_g=self.mass_g,
            extents_mm=(solid.extents_min_mm, solid.extents_max_mm),
        )

    @property
    def traits(self) -> Any:
        """Table of the traits with units, 90 % intervals, verdicts, reasons and definitions.

        The table is a pandas data frame, indexed by the name of the trait.
        """
        rows = trait_table.to_json(self.measured, assessments.assess(self.summary(), self.measured))["traits"]
        import pandas as pd

        return pd.DataFrame(rows).set_index("name")

    def __repr__(self) -> str:
        """Return a short summary as text."""
        used = sum(camera.used for camera in self.cameras)
        rows = [
            ("volume", f"{ml(self.volume_mm3, half_mm3=0.5 * (self.interval_mm3[1] - self.interval_mm3[0]))} ml"),
            ("90 % interval", f"{interval_ml(*self.interval_mm3)} ({self.solid.volume.calibration.text})"),
            ("usable", "yes" if self.trusted else f"no: {self.verdict}"),
            ("roots", f"{len(self.roots)}, total length {self.solid.length_mm:.0f} mm" if self.roots else "no centre lines"),
            ("views", f"{used} of {len(self.cameras)} used"),
            ("warnings", str(len(self.warnings))),
            ("dataset", self.dataset),
        ]
        return "\n".join([f"Result of {self.scene}", *(f"  {name:<14}{text}" for name, text in rows)])

    def _repr_html_(self) -> str | None:
        """Return the HTML representation for notebooks, or None if the text representation is to be used."""
        return None if self.notebook is None else self.notebook(self)

    def summary(self) -> Json:
        """Return the contents of ``result.json``, excluding the traits."""
        solid, volume = self.solid, self.solid.volume
        return {
            "schema_version": SCHEMA_VERSION,
            "dataset": self.dataset,
            "dataset_sha256": self.dataset_sha256,
            "scene": self.scene,
            "subject": to_plain(self.subject),
            "solution": to_plain(self.solution),
            "plants": [one.plain() for one in self.plants],
            "strip": to_plain(self.strip),
            "voxel_mm": solid.voxel_mm,
            "volume_mm3": volume.mm3,
            "volume_interval_mm3": volume.interval_mm3,
            "volume_bounds_mm3": volume.bounds_mm3,
            "volume_trusted": volume.trusted,
            "volume_verdict": volume.verdict,
            "checks": [asdict(check) for check in self.checks],
            "estimates": [asdict(estimate) for estimate in self.estimates],
            "volume_budget": [asdict(term) for term in volume.terms],
            "calibration": volume.calibration.plain(),
            "hull_mm3": solid.hull_mm3,
            "untrimmed_mm3": solid.untrimmed_mm3,
            "blind_mm3": solid.blind_mm3,
            "hidden_height_mm": solid.hidden_height_mm,
            "root_mu_per_mm": solid.mu_per_mm,
            "root_mu_sigma_per_mm": solid.mu_sigma_per_mm,
            "length_mm": solid.length_mm,
            "tips": sum(root.tip_seen for root in solid.roots),
            "mass_g": self.mass_g,
            "extents_min_mm": solid.extents_min_mm,
            "extents_max_mm": solid.extents_max_mm,
            "views": [self._view(camera) for camera in self.cameras],
            "shoot": None if self.shoot is None else self.shoot.summary(),
            **({} if self.edits is None else {"edits": self.edits}),
            "bands": dict(self.bands),
            "rig": self.rig,
            "warnings": list(self.warnings),
            "timings_s": self.timings_s,
            **self.passes,
            "peak_memory_mib": self.peak_memory_mib,
            "settings": self.settings,
            "versions": self.versions,
        }

    def _view(self, camera: Camera) -> Json:
        """Return the entry of a camera in ``result.json``."""
        plain = {name: getattr(camera, name) for name in (*_VIEW_KEYS, "markers", "table_deg")}
        poses = {name: None if (pose := plain[name]) is None else pose.tolist() for name in POSES}
        return plain | poses | {"fill": self.fill.get(camera.file)}

    def save(self, folder: Path | str) -> None:
        """Write the result to a folder.

        The file ``result.json`` is written last, so that a folder with this file is complete.

        Raises
        ------
        OSError
            If a file cannot be written.
        """
        begin, folder, solid = time.perf_counter(), Path(folder), self.solid
        (folder / "result.json").unlink(missing_ok=True)
        atomic.write_bytes(folder / "shape.npz", shape_npz(solid.voxels, solid.hull))
        atomic.write_bytes(folder / "shape.ply", bytes(trimesh.exchange.ply.export_ply(solid.mesh)))
        (folder / "shoot.ply").unlink(missing_ok=True)
        if self.shoot is not None:
            atomic.write_bytes(folder / "shoot.ply", bytes(trimesh.exchange.ply.export_ply(self.shoot.mesh)))
        for name in ("roots.rsml", "roots.csv", "leaves.csv"):
            (folder / name).unlink(missing_ok=True)
        if solid.roots:
            rsml.write_rsml(folder / "roots.rsml", solid.roots)
        for file, silhouette in self.silhouettes.items():
            atomic.write_image(picture_path(folder / "silhouettes", file), np.round(silhouette.coverage * 65535.0).astype(np.uint16))
            atomic.write_image(picture_path(folder / "seen", file), silhouette.usable.astype(np.uint8) * 255)
        summary = self.summary()
        for name, text in result_traits.trait_files(self.measured, summary, solid.roots, mass_g=self.mass_g).items():
            atomic.write_text(folder / name, text)
        summary["timings_s"] = self.timings_s | {"write": time.perf_counter() - begin}
        atomic.write_json(folder / "result.json", summary | {"traits": to_plain(self.measured)})
