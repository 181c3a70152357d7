"""Camera pose from the marker strip in a single picture.

This is the only module of the package rig that uses the reconstruction.
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
"""Maximum reprojection error, px. At larger errors, the markers are inconsistent with the scene's strip and camera."""


@dataclass(frozen=True, kw_only=True)
class Sighting:
    """Camera pose and markers measured in one picture of the strip."""

    cam_from_canister: Array
    """Camera pose (4, 4) relative to the canister, with OpenCV axes of the camera."""
    markers: int
    reprojection_px: float
    corners_px: Array = field(default_factory=lambda: np.zeros((0, 4, 2)))
    """Corners of the markers, px, shape (M, 4, 2)."""
    blur_px: float | None = None
    """Median standard deviation of the blur of the markers, px. It includes the averaging over the area of a pixel,
    which has a standard deviation of 0.29 px."""

    @property
    def azimuth_deg(self) -> float:
        """Azimuth of the camera about the canister's axis, deg.

        The azimuth is 0 at the strip's seam, and increases counter-clockwise seen from above.
        """
        x, y, _ = frames.invert(self.cam_from_canister)[:3, 3]
        return float(np.rad2deg(np.arctan2(y, x)))

    def cam_from_rig(self, table_deg: float, *, direction: int) -> Array:
        """Return the camera pose ``cam_from_rig`` (4, 4) for a table angle (deg) and a sense of rotation (1 or -1)."""
        return self.cam_from_canister @ frames.rotation_z(-direction * np.deg2rad(table_deg))


def read_strip(image: Grey, scene: Scene) -> Sighting | None:
    """Measure the camera's pose from the markers in one picture.

    The result is None if the strip cannot be read. The reason is then returned by `unread_reason`.

    Parameters
    ----------
    image : (H, W) uint8 or uint16 array
        Picture with the size of the scene's camera.
    scene : Scene
        Scene with strip, net pot and calibrated camera.
    """
    found = _read(image, scene)
    return found if isinstance(found, Sighting) else None


def read_ids(image: Grey, strip: MarkerStrip) -> tuple[int, ...]:
    """Return the sorted ids of all markers in a picture that are in the dictionary of the strip.

    They include markers of other strips with the same dictionary.

    Parameters
    ----------
    image : (H, W) uint8 or uint16 array
        Picture to search.
    strip : MarkerStrip
        Strip with the dictionary. Its range of ids is not used.
    """
    found = detect_markers(image, strip, measure=False)
    return tuple(sorted({*(int(one) for one in found.ids), *found.foreign}))


def unread_reason(image: Grey, scene: Scene) -> str:
    """Return the reason why the strip in a picture cannot be read, or an empty text if it can be read."""
    found = _read(image, scene)
    return found if isinstance(found, str) else ""


def _read(image: Grey, scene: Scene) -> Sighting | str:
    markers = detect_markers(image, scene.strip)
    count = len(markers.ids)
    if count < LEAST_MARKERS:
        return markers.diagnosis or f"only {count} markers were found, but at least {LEAST_MARKERS} are needed"
    seen = sightings(markers, scene)
    pose = single_view(seen)
    reprojection_px = np.inf if pose is None else linearise(seen, pose).rms_px
    if pose is None or not reprojection_px < WORST_PX:
        return (
            f"{count} markers do not fit the strip and camera of the scene; check the strip's dimensions and the camera in the scene file"
        )
    return Sighting(
        cam_from_canister=pose,
        markers=count,
        reprojection_px=float(reprojection_px),
        corners_px=markers.corners_px,
        blur_px=None if markers.blur_px is None else float(np.median(markers.blur_px)),
    )
