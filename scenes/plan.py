"""Views of a capture plan with their commanded positions, and the visibility of markers in these views."""

from dataclasses import dataclass

import numpy as np

from rhizotwin.scenes import frames
from rhizotwin.scenes.frames import Array
from rhizotwin.scenes.model import MarkerStrip, NetPot, Scene

SLANT = 0.5
"""Minimum cosine of the angle between the normal of a marker and the direction to the camera. At a smaller cosine, the
marker is too oblique to be detected."""
LEAST_MARKERS = 4
"""Minimum number of completely visible markers for estimating a pose. Four markers provide sixteen corners for six
unknowns. With fewer markers, a wrongly identified marker could not be detected."""


@dataclass(frozen=True, kw_only=True)
class View:
    """View to be taken, with the commanded positions of the camera and the table."""

    index: int
    ring: int
    kind: str
    table_deg: float
    cam_from_rig: frames.Array


def views(scene: Scene, *, seed: int = 0) -> list[View]:
    """Expand the plan of a scene into its views, in the order of capture.

    The random change of the camera's pose in view k of a ring depends only on ``seed``, the ring and k.
    """
    found: list[View] = []
    for ring_index, ring in enumerate(scene.plan.rings):
        nominal = frames.level_camera(distance_mm=ring.distance_mm, height_mm=ring.height_mm, tilt_deg=ring.tilt_deg)
        for k in range(ring.views):
            cam_from_rig = nominal
            if ring.jitter_mm or ring.jitter_deg:
                rng = np.random.default_rng([seed, 11, ring_index, k])
                shift_mm = rng.normal(0.0, ring.jitter_mm, 3)
                turn_rad = np.deg2rad(rng.normal(0.0, ring.jitter_deg, 3))
                cam_from_rig = frames.from_rotvec(turn_rad, shift_mm) @ nominal
            found.append(
                View(
                    index=len(found),
                    ring=ring_index,
                    kind=ring.kind,
                    table_deg=ring.first_deg + ring.span_deg * k / ring.views,
                    cam_from_rig=cam_from_rig,
                )
            )
    return found


def ring_bands(scene: Scene, ring: int) -> tuple[str, ...]:
    """Return the names of the bands in which a ring is taken. If there are no bands, the result is one empty name."""
    return scene.plan.rings[ring].bands or tuple(band.name for band in scene.camera.bands) or ("",)


def count_pictures(scene: Scene) -> int:
    """Return the number of pictures of a scan: one per view and band."""
    return sum(ring.views * len(ring_bands(scene, number)) for number, ring in enumerate(scene.plan.rings))


def main_band(scene: Scene, ring: int) -> str:
    """Return the name of the band of a ring in which outlines and markers are visible.

    It is the first band with both lights on.
    """
    return next(band for band in ring_bands(scene, ring) if not band or scene.is_lit(band))


def picture_name(view: int, band: str) -> str:
    """Return the name of a view's picture in a band, without folder and suffix."""
    return f"view_{view:03d}_{band}" if band else f"view_{view:03d}"


def rig_from_table(scene: Scene, table_deg: float) -> frames.Array:
    """Return the 4x4 transform from the table frame to the rig frame for a table angle (deg)."""
    return frames.rotation_z(scene.turntable.direction * np.deg2rad(table_deg))


def marker_corners(strip: MarkerStrip, net_pot: NetPot) -> dict[int, frames.Array]:
    """Return the corners (4, 3) of all markers in the strip's frame, mm. The keys are marker ids.

    The strip's frame equals the canister frame if the net pot is seated correctly.

    Corners are ordered as in OpenCV: top left, top right, bottom right, bottom left, seen from outside.
    """
    from rhizotwin.scenes.markers import strip_ids  # imported here: it loads OpenCV, which takes half a second

    half_rad = strip.marker_mm / net_pot.outer_radius_mm / 2.0
    ids = strip_ids(strip)
    corners: dict[int, frames.Array] = {}
    for row in range(strip.rows):
        low = strip.bottom_mm + (strip.rows - 1 - row) * strip.row_pitch_mm
        high = low + strip.marker_mm
        for column in range(strip.columns):
            middle = (column + 0.5) * 2.0 * np.pi / strip.columns
            angle = np.array([middle - half_rad, middle + half_rad, middle + half_rad, middle - half_rad])
            z = np.array([high, high, low, low])
            xy = net_pot.outer_radius_mm * np.stack([np.cos(angle), np.sin(angle)], axis=1)
            corners[int(ids[row, column])] = np.concatenate([xy, z[:, None]], axis=1)
    return corners


def visible_markers(scene: Scene, cam_from_rig: Array) -> int:
    """Return the number of markers that are completely visible to a camera at a sufficient angle.

    The strip is assumed to be untilted and at table angle 0.

    Parameters
    ----------
    scene : Scene
        Scene with strip, net pot and camera.
    cam_from_rig : (4, 4) array
        Pose of the camera.

    Returns
    -------
    int
        Number of visible markers.
    """
    camera, pose = scene.camera.as_pinhole(), scene.camera.pinhole_pose(cam_from_rig)
    centre = frames.invert(pose)[:3, 3]
    width, height = camera.image_wh
    (fx, fy), (cx, cy) = camera.focal_px, camera.principal_px
    count = 0
    for corners in marker_corners(scene.strip, scene.net_pot).values():
        outward, toward = corners[:, :2].mean(axis=0), centre[:2] - corners[:, :2].mean(axis=0)
        facing = outward @ toward > SLANT * np.linalg.norm(outward) * np.linalg.norm(toward)
        x, y, z = frames.apply(pose, corners).T
        if facing and z.min() > 0.0:
            u, v = fx * x / z + cx, fy * y / z + cy
            count += bool(u.min() > 0.0 and u.max() < width - 1 and v.min() > 0.0 and v.max() < height - 1)
    return count


def marker_warnings(scene: Scene) -> list[str]:
    """Return a warning for each ring of the roots in which too few markers are completely visible.

    For a pose estimate, `LEAST_MARKERS` are required. The strip is visible from a short distance only if the camera is
    high enough or tilted up.
    """
    found = []
    for number, ring in enumerate(scene.plan.rings, start=1):
        level = frames.level_camera(distance_mm=ring.distance_mm, height_mm=ring.height_mm, tilt_deg=ring.tilt_deg)
        if scene.strip.rows and ring.kind == "root" and visible_markers(scene, level) < LEAST_MARKERS:
            found.append(
                f"ring {number} ({ring.distance_mm:g} mm away, height {ring.height_mm:g} mm) sees fewer than {LEAST_MARKERS} complete "
                "markers, so that its cameras cannot be calibrated; raise the camera, tilt it up, or increase its distance"
            )
    return found
