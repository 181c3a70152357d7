"""Reconstructed shoot, with measurements of its hull and silhouettes."""

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
    """Surface of the visual hull in air, canister frame, mm."""
    hull_mm3: float
    """Volume of the visual hull, mm3. It is the upper limit for a shoot with these silhouettes, and several times the
    volume of thin leaves."""
    blades_mm2: tuple[float, ...]
    """One-sided area of each separate blade, in decreasing order, mm2. Touching blades count as one."""
    leaf_area_mm2: float | None
    """One-sided area of all blades, mm2, computed as half of the hull's surface area at the blades. The hull of a blade
    is a thin lens around the blade, with nearly the same area on both sides. None if leaves enclose space that no
    picture shows, because the hull is solid there."""
    stalks_mm3: float
    """Volume of the parts of the hull that are stem or petiole, mm3."""
    leaf_thickness_mm: float | None = None
    """Thickness of the blades, mm. It is measured by the user, because the pictures do not resolve it, and None if
    unknown."""
    pot_top_mm: float
    """Height (z) of the net pot's top in the canister frame, mm."""
    covered_px: Mapping[str, float]
    """Number of pixels that the shoot covers in each picture, keyed by the picture's file."""
    mm2_per_px: Mapping[str, float]
    """Area of a pixel at the canister's axis in each picture, mm2, keyed by the picture's file."""
    hidden_share: float
    """Fraction of the covered pixels that are in front of the net pot or beside the panel, instead of in front of the
    panel. Such pixels do not constrain the hull."""
    enclosed_share: float
    """Fraction of the hull's volume that lies deeper inside the hull than leaves and stalks do."""
    colour: Mapping[str, float] = field(default_factory=dict)
    """Reflectances of the leaves relative to white paper, one for each wavelength range, and vegetation indices. The
    keys are the field names in `scenes.trait_table.COLOURS`. The mapping is empty if the shoot was photographed in only
    one band."""
    leaf_colours: tuple[Mapping[str, float], ...] = ()
    """The same for each blade, in the order of ``blades_mm2``. It is empty if it was not measured."""
    warnings: tuple[str, ...] = ()
    """Warnings for the user."""

    @property
    def projected_mm2(self) -> dict[str, float]:
        """Return the area covered in each picture, mm2, keyed by the picture's file.

        The area is computed at the scale of the canister's axis.
        """
        return {file: pixels * self.mm2_per_px[file] for file, pixels in self.covered_px.items()}

    @property
    def height_mm(self) -> float:
        """Return the height of the shoot's highest point above the top of the net pot, mm."""
        return float(self.mesh.vertices[:, 2].max()) - self.pot_top_mm

    @property
    def width_mm(self) -> tuple[float, float]:
        """Return the widths of the bounding box along x and y of the canister frame, mm."""
        x, y, _ = np.ptp(self.mesh.vertices, axis=0)
        return float(x), float(y)

    @property
    def surface_area_mm2(self) -> float:
        """Return half of the hull's surface area, mm2.

        This is the one-sided area of the blades plus half of the surface area of the stalks.
        """
        return 0.5 * float(self.mesh.area)

    @property
    def leaves(self) -> int:
        """Return the number of separate blades, which is at most the number of leaves."""
        return len(self.blades_mm2)

    @property
    def volume_mm3(self) -> float | None:
        """Return the volume of the shoot, mm3.

        It is the volume of the stalks, plus the leaf area times the measured leaf thickness. It is None if the leaf
        area or the leaf thickness is unknown.
        """
        if self.leaf_thickness_mm is None or self.leaf_area_mm2 is None:
            return None
        return self.stalks_mm3 + self.leaf_area_mm2 * self.leaf_thickness_mm

    @property
    def projected_mean_mm2(self) -> float:
        """Return the projected area, averaged over the pictures, mm2."""
        return sum(self.projected_mm2.values()) / max(1, len(self.covered_px))

    @property
    def convex_mm3(self) -> float:
        """Return the volume of the shoot's convex hull, mm3."""
        return float(ConvexHull(np.asarray(self.mesh.vertices)).volume)

    def summary(self) -> Json:
        """Return the measurements of the shoot for ``result.json``, keyed by trait name."""
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
            "leaf_colours": [dict(one) for one in self.leaf_colours],
            **self.colour,
        }
