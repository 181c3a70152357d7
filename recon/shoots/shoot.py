"""Reconstructed shoot: its hull in air, and measurements on the hull and the silhouettes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import trimesh
from scipy.spatial import ConvexHull

Json = dict[str, object]


@dataclass(frozen=True, kw_only=True)
class Shoot:
    """Reconstruction of the shoot above the net pot."""

    mesh: trimesh.Trimesh = field(repr=False)
    """Surface of the visual hull, canister frame, mm."""
    hull_mm3: float
    """Volume of the visual hull, the upper limit for a shoot with these silhouettes; several times the volume of thin
    leaves."""
    blades_mm2: tuple[float, ...]
    """One-sided area of each separate blade, the largest first; touching blades count as one."""
    leaf_area_mm2: float | None
    """One-sided area of all blades, as half of the hull's surface there: the hull of a blade is a thin lens about it,
    with nearly the same area on both sides. None if leaves enclose space that no picture shows, as the hull is solid
    there."""
    stalks_mm3: float
    """Volume of the hull's stem and petioles."""
    leaf_thickness_mm: float | None = None
    """Measured thickness of blades; pictures do not resolve it."""
    pot_top_mm: float
    """Height (z) of the net pot's top."""
    covered_px: Mapping[str, float]
    """Number of pixels covered by the shoot, by the frame's file."""
    mm2_per_px: Mapping[str, float]
    """Area of a pixel at the canister's axis, by the frame's file."""
    hidden_share: float
    """Fraction of the covered pixels in front of the pot or beside the panel, where the hull is not constrained."""
    enclosed_share: float
    """Fraction of the hull's volume that is deeper inside it than leaves and stalks permit."""
    colour: Mapping[str, float] = field(default_factory=dict)
    """Reflectance of the leaves in each range of wavelengths, relative to white paper, and vegetation indices, by the
    field's name in `scenes.trait_table.COLOURS`; empty if the shoot was taken in one band."""
    warnings: tuple[str, ...] = ()

    @property
    def projected_mm2(self) -> dict[str, float]:
        """Area covered in each picture, at the scale of the canister's axis, by the frame's file."""
        return {file: pixels * self.mm2_per_px[file] for file, pixels in self.covered_px.items()}

    @property
    def height_mm(self) -> float:
        """Highest point above the net pot's top."""
        return float(self.mesh.vertices[:, 2].max()) - self.pot_top_mm

    @property
    def width_mm(self) -> tuple[float, float]:
        """Widths of the bounding box along x and y of the canister frame."""
        x, y, _ = np.ptp(self.mesh.vertices, axis=0)
        return float(x), float(y)

    @property
    def surface_area_mm2(self) -> float:
        """One-sided area of blades plus half the surface of stalks, which is half of the hull's surface."""
        return 0.5 * float(self.mesh.area)

    @property
    def leaves(self) -> int:
        """Number of separate blades, at most the number of leaves."""
        return len(self.blades_mm2)

    @property
    def volume_mm3(self) -> float | None:
        """Volume of stalks, and of blades from their area and measured thickness; None if either is unknown."""
        if self.leaf_thickness_mm is None or self.leaf_area_mm2 is None:
            return None
        return self.stalks_mm3 + self.leaf_area_mm2 * self.leaf_thickness_mm

    @property
    def projected_mean_mm2(self) -> float:
        """Mean projected area over the pictures."""
        return sum(self.projected_mm2.values()) / max(1, len(self.covered_px))

    @property
    def convex_mm3(self) -> float:
        """Volume of the convex hull."""
        return float(ConvexHull(np.asarray(self.mesh.vertices)).volume)

    def summary(self) -> Json:
        """Return the numbers for ``result.json``."""
        return {
            "height_mm": self.height_mm,
            "width_mm": list(self.width_mm),
            "surface_area_mm2": self.surface_area_mm2,
            "leaf_area_mm2": self.leaf_area_mm2,
            "leaves": self.leaves,
            "blades_mm2": list(self.blades_mm2),
            "stalks_mm3": self.stalks_mm3,
            "leaf_thickness_mm": self.leaf_thickness_mm,
            "volume_mm3": self.volume_mm3,
            "projected_mean_mm2": self.projected_mean_mm2,
            "covered_px": dict(self.covered_px),
            "mm2_per_px": dict(self.mm2_per_px),
            "hull_mm3": self.hull_mm3,
            "convex_mm3": self.convex_mm3,
            "pot_top_mm": self.pot_top_mm,
            "hidden_share": self.hidden_share,
            "enclosed_share": self.enclosed_share,
            **self.colour,
        }
