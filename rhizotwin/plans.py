"""Capture plans to be compared, and their scores."""

import math
from dataclasses import dataclass, replace

from rhizotwin.scenes.model import CapturePlan, Ring, Scene


@dataclass(frozen=True, order=True)
class Height:
    """Camera height of a ring, with optional tilt and distance."""

    mm: float
    """Height in the rig frame (0 is the rim of the canister)."""
    tilt_deg: float | None = None
    """Tilt of the optical axis below the horizon; None: aimed at the target of the scene's first ring."""
    distance_mm: float | None = None
    """Distance from the turntable axis; None: as in the scene's first ring."""

    @property
    def name(self) -> str:
        """Height in the notation of the command line."""
        tilt = "" if self.tilt_deg is None else f":{self.tilt_deg:g}"
        return f"{self.mm:g}{tilt}" + ("" if self.distance_mm is None else f"@{self.distance_mm:g}")


@dataclass(frozen=True, kw_only=True)
class Variant:
    """Capture plan to be evaluated."""

    heights: tuple[Height, ...]
    """Camera heights, one per ring."""
    views: int
    """Number of views per ring."""
    image_wh: tuple[int, int]

    @property
    def name(self) -> str:
        """Short name, also used in file names."""
        heights = "_".join(height.name.replace(":", "tilt").replace("@", "from") for height in self.heights)
        return f"{self.views}x{self.image_wh[0]}x{self.image_wh[1]}_at_{heights}"

    def of(self, scene: Scene) -> Scene:
        """Return the scene with this plan.

        Rings without a distance use that of the scene's first ring; the views of the rings are interleaved.
        """
        first = scene.plan.rings[0]
        aim_mm = first.height_mm - first.distance_mm * math.tan(math.radians(first.tilt_deg))
        rings = []
        for k, height in enumerate(self.heights):
            away_mm = height.distance_mm or first.distance_mm
            tilt_deg = math.degrees(math.atan2(height.mm - aim_mm, away_mm)) if height.tilt_deg is None else height.tilt_deg
            first_deg = first.first_deg + k * 360.0 / self.views / len(self.heights)
            rings.append(Ring(views=self.views, height_mm=height.mm, distance_mm=away_mm, tilt_deg=tilt_deg, first_deg=first_deg))
        return replace(scene, plan=CapturePlan(rings=tuple(rings)), camera=scene.camera.resized(self.image_wh))


@dataclass(frozen=True, kw_only=True)
class Row:
    """Scores of a plan: medians over the seeds."""

    variant: Variant
    pictures: int
    volume_error: float
    """Median of found / true - 1."""
    volume_error_worst: float
    """Largest absolute value."""
    volume_errors: tuple[float, ...]
    """Value for each seed."""
    interval_width: float
    """Width of the interval relative to the true volume."""
    interval_holds: float
    """Fraction of the runs whose interval contains the true volume."""
    length_error: float | None
    """Median of found / true - 1; None if there are no roots, or a run found none."""
    length_error_worst: float | None
    length_errors: tuple[float, ...]
    recall: float
    """Median recall: of the roots' centre lines, or of voxels if there are no roots."""
    precision: float
    """Median precision, likewise."""
    capture_min: float
    """Duration of the scan."""
    compute_s: float
    """Duration of the reconstruction."""
