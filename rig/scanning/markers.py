"""Camera pose from the marker strip in one picture.

This is the only module of the rig that uses the reconstruction.
"""

from dataclasses import dataclass, field

import numpy as np

from rhizotwin.recon.calibration.markers import detect_markers
from rhizotwin.recon.calibration.view_fit import linearise, sightings, single_view
from rhizotwin.scenes import frames
from rhizotwin.scenes.frames import Array
from rhizotwin.scenes.model import MarkerStrip, Scene
from rhizotwin.scenes.picture_codec import Grey
from rhizotwin.scenes.plan import LEAST_MARKERS

WORST_PX = 3.0
"""Reprojection error beyond which the markers are inconsistent with the scene's strip and camera."""


@dataclass(frozen=True, kw_only=True)
class Sighting:
    """Measurement of the strip in one picture."""

    cam_from_canister: Array
    """(4, 4) pose, OpenCV axes."""
    markers: int
    reprojection_px: float
    corners_px: Array = field(default_factory=lambda: np.zeros((0, 4, 2)))
    """(M, 4, 2) corners of the markers."""
    blur_px: float | None = None
    """Median standard deviation of the markers' blur, including the pixel's own (0.29)."""

    @property
    def azimuth_deg(self) -> float:
        """Azimuth of the camera about the canister's axis, from the strip's seam, counter-clockwise seen from above."""
        x, y, _ = frames.invert(self.cam_from_canister)[:3, 3]
        return float(np.rad2deg(np.arctan2(y, x)))

    def cam_from_rig(self, table_deg: float, *, direction: int) -> Array:
        """Return ``cam_from_rig`` (4, 4) for a known table angle."""
        return self.cam_from_canister @ frames.rotation_z(-direction * np.deg2rad(table_deg))


def read_strip(image: Grey, scene: Scene) -> Sighting | None:
    """Compute the camera's pose from the markers in one picture.

    Return None if the strip cannot be read (`unread_reason` returns the reason).

    Parameters
    ----------
    image : (H, W) uint8 or uint16 array
        Picture of the size of the scene's camera.
    scene : Scene
        Strip, net pot and camera with its calibrated lens.
    """
    found = _read(image, scene)
    return found if isinstance(found, Sighting) else None


def read_ids(image: Grey, strip: MarkerStrip) -> tuple[int, ...]:
    """Return the ids of all markers of a strip's dictionary in one picture, also those of other strips, ascending.

    Parameters
    ----------
    image : (H, W) uint8 or uint16 array
        The picture.
    strip : MarkerStrip
        Its dictionary is searched; its ids do not matter.
    """
    found = detect_markers(image, strip, measure=False)
    return tuple(sorted({*(int(one) for one in found.ids), *found.foreign}))


def unread_reason(image: Grey, scene: Scene) -> str:
    """Return the reason why the strip in a picture cannot be read; empty if it can."""
    found = _read(image, scene)
    return found if isinstance(found, str) else ""


def _read(image: Grey, scene: Scene) -> Sighting | str:
    markers = detect_markers(image, scene.strip)
    count = len(markers.ids)
    if count < LEAST_MARKERS:
        return markers.diagnosis or f"only {count} markers were found, at least {LEAST_MARKERS} are needed"
    seen = sightings(markers, scene)
    pose = single_view(seen)
    reprojection_px = np.inf if pose is None else linearise(seen, pose).rms_px
    if pose is None or not reprojection_px < WORST_PX:
        return f"{count} markers do not fit the scene's strip and lens: check the strip's sizes and the camera in the scene file"
    return Sighting(
        cam_from_canister=pose,
        markers=count,
        reprojection_px=float(reprojection_px),
        corners_px=markers.corners_px,
        blur_px=None if markers.blur_px is None else float(np.median(markers.blur_px)),
    )
