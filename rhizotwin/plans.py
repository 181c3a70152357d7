"""Capture plans to try, and how well each did."""

import math
from dataclasses import dataclass, replace

from rhizotwin.scenes.model import CapturePlan, Ring, Scene


@dataclass(frozen=True, order=True)
class Height:
    """Where the camera of a ring stands, and how it looks."""

    mm: float
    """In the rig frame (0 is the canister's rim)."""
    tilt_deg: float | None = None
    """Optical axis below the horizon; None: it looks at what the scene's first ring looks at."""
    distance_mm: float | None = None
    """From the table's axis; None: that of the scene's first ring."""

    @property
    def name(self) -> str:
        """As people type it."""
        tilt = "" if self.tilt_deg is None else f":{self.tilt_deg:g}"
        return f"{self.mm:g}{tilt}" + ("" if self.distance_mm is None else f"@{self.distance_mm:g}")


@dataclass(frozen=True, kw_only=True)
class Variant:
    """A capture plan to try."""

    heights: tuple[Height, ...]
    """Of the camera, one a ring."""
    views: int
    """In each ring."""
    image_wh: tuple[int, int]

    @property
    def name(self) -> str:
        """Short name, also of its file."""
        heights = "_".join(height.name.replace(":", "tilt").replace("@", "from") for height in self.heights)
        return f"{self.views}x{self.image_wh[0]}x{self.image_wh[1]}_at_{heights}"

    def of(self, scene: Scene) -> Scene:
        """Return the scene with this plan.

        Rings stand at the distance of the scene's first one where they have none of their own; their views are
        interleaved.
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
    """How well a plan does: medians over the seeds."""

    variant: Variant
    pictures: int
    volume_error: float
    """Median of found / true - 1."""
    volume_error_worst: float
    """The largest without its sign."""
    volume_errors: tuple[float, ...]
    """Of each seed."""
    interval_width: float
    """Of the stated interval, over the true volume."""
    interval_holds: float
    """Share of the runs whose interval holds the truth."""
    length_error: float | None
    """Median of found / true - 1; None for what has no roots, or where a run found none."""
    length_error_worst: float | None
    length_errors: tuple[float, ...]
    recall: float
    """Median share of what is there that was found: of the roots' centre lines, or of the voxels of what has no
    roots."""
    precision: float
    """Median share of what was found that is there."""
    capture_min: float
    """At the bench."""
    compute_s: float
    """Reconstruction."""
