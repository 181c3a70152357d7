"""Capture plans for comparison, and their scores."""

import math
from dataclasses import dataclass, replace

from rhizotwin.scenes.model import CapturePlan, Scene


@dataclass(frozen=True, order=True)
class Height:
    """Camera position of a ring: height, and optionally tilt and distance."""

    mm: float
    """Height of the camera in the rig frame, in mm. The rim of the canister is at 0."""
    tilt_deg: float | None = None
    """Tilt of the optical axis below the horizon, in degrees. If it is None, the camera is aimed at the target point of
    the scene's first ring."""
    distance_mm: float | None = None
    """Distance of the camera from the turntable axis, in mm. If it is None, the distance of the scene's first ring is
    used."""

    @property
    def name(self) -> str:
        """Camera position as written on the command line, such as ``10:5@300``."""
        tilt = "" if self.tilt_deg is None else f":{self.tilt_deg:g}"
        return f"{self.mm:g}{tilt}" + ("" if self.distance_mm is None else f"@{self.distance_mm:g}")


@dataclass(frozen=True, kw_only=True)
class Variant:
    """Capture plan to be compared with others."""

    heights: tuple[Height, ...]
    """Camera position of each ring."""
    views: int
    """Number of views per ring."""
    image_wh: tuple[int, int]

    @property
    def name(self) -> str:
        """Short name of the plan, also used in file names."""
        heights = "_".join(height.name.replace(":", "tilt").replace("@", "from") for height in self.heights)
        return f"{self.views}x{self.image_wh[0]}x{self.image_wh[1]}_at_{heights}"

    def of(self, scene: Scene) -> Scene:
        """Return a copy of the scene with this capture plan.

        Rings without a distance use the distance of the scene's first ring. Its angle of rotation, jitter and bands
        apply to all rings. The table angles of the rings are interleaved.
        """
        first = scene.plan.rings[0]
        aim_mm = first.height_mm - first.distance_mm * math.tan(math.radians(first.tilt_deg))
        rings = []
        for k, height in enumerate(self.heights):
            away_mm = height.distance_mm or first.distance_mm
            tilt_deg = math.degrees(math.atan2(height.mm - aim_mm, away_mm)) if height.tilt_deg is None else height.tilt_deg
            first_deg = first.first_deg + k * first.span_deg / self.views / len(self.heights)
            placed = replace(first, height_mm=height.mm, distance_mm=away_mm, tilt_deg=tilt_deg)
            rings.append(replace(placed, kind="root", views=self.views, first_deg=first_deg))
        return replace(scene, plan=CapturePlan(rings=tuple(rings)), camera=scene.camera.resized(self.image_wh))


@dataclass(frozen=True, kw_only=True)
class Row:
    """Scores of a capture plan, combined over the random seeds."""

    variant: Variant
    pictures: int
    volume_error: float
    """Median relative volume error, reconstructed / true - 1."""
    volume_error_worst: float
    """Largest absolute relative volume error over the seeds."""
    volume_errors: tuple[float, ...]
    """Relative volume error for each seed."""
    interval_width: float
    """Median width of the 90 % interval of the volume, relative to the true volume."""
    interval_holds: float
    """Fraction of the runs in which the 90 % interval contains the true volume."""
    length_error: float | None
    """Median relative error of the total root length, reconstructed / true - 1. It is None if the root lengths could
    not be scored in every run."""
    length_error_worst: float | None
    length_errors: tuple[float, ...]
    recall: float
    """Median recall of the centre lines of the roots. It is the recall of the voxels if the roots could not be scored
    in every run."""
    precision: float
    """Median precision of the centre lines of the roots. It is the precision of the voxels if the roots could not be
    scored in every run."""
    capture_min: float
    """Estimated duration of the scan, in minutes."""
    compute_s: float
    """Median duration of the reconstruction, in seconds."""
