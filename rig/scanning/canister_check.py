"""Verification that the same canister stands at the same place of the table in all pictures of a ring."""

from collections.abc import Sequence

import numpy as np

from rhizotwin.rig.scanning.markers import read_ids
from rhizotwin.scenes import frames
from rhizotwin.scenes.frames import Array
from rhizotwin.scenes.markers import strip_ids
from rhizotwin.scenes.model import MarkerStrip, Scene
from rhizotwin.scenes.picture_codec import Grey
from rhizotwin.scenes.plan import LEAST_MARKERS

SHIFT_MM = 1.0
"""Displacement of the canister or the camera that is reported, mm. In scans of the twin with the profiles bench, harsh
and real, the measured positions deviate from a circle by at most 0.13 mm."""
NOISE_MM, ECCENTRIC_MM, WOBBLE_MM = 0.13, 3.0, 0.5
"""Standard deviations, mm, of a measured position and, before any picture was taken, of the distance between the axes
of net pot and table, and of the vertical motion of the net pot."""
SIGMAS = 4.0
"""Displacement that is reported, in standard deviations of the predicted position, which is uncertain at first."""
HIDDEN_DEG = 45.0
"""Turn of the table within which a leaf can hide the strip, deg. A leaf 30 mm wide, 50 mm from the axis, does for 34
deg."""


def other_canister(image: Grey, strip: MarkerStrip) -> str | None:
    """Return the marker numbers of another canister in a picture.

    The text is empty if the strip itself, or some of its markers, can be seen. It is None if there are no markers.
    """
    ids = read_ids(image, strip)
    foreign = sorted({*ids} - {*strip_ids(strip).ravel().tolist()})
    if len(foreign) >= LEAST_MARKERS and 2 * len(foreign) > len(ids):
        return ", ".join(map(str, foreign))
    return "" if ids else None


def shift_mm(table_deg: Sequence[float], cam_from_canister: Sequence[Array], scene: Scene) -> float:
    """Return by how much the strip in the last picture is beside the place that the others predict, mm.

    The place is that of the point of the strip that faces the camera, which is measured more accurately than the axis.
    Seen from a static camera, it moves on a circle, p = c + u cos(angle) + v sin(angle), because net pot and table are
    not exactly coaxial. The coefficients are those of a linear regression with a prior of u and v. The result is 0 if
    the prediction is too uncertain.

    Parameters
    ----------
    table_deg : sequence of float
        Measured table angles of N pictures, deg.
    cam_from_canister : sequence of (4, 4) array
        Camera poses measured in these pictures.
    scene : Scene
        Scene with net pot, strip and the table's direction of rotation.
    """
    if len(table_deg) < 2:
        return 0.0
    angles = np.deg2rad(table_deg)
    x, y, _ = frames.invert(cam_from_canister[0])[:3, 3]
    azimuths = np.arctan2(y, x) - scene.turntable.direction * (angles - angles[0])
    strip, radius_mm = scene.strip, scene.net_pot.outer_radius_mm
    height_mm = strip.bottom_mm + ((strip.rows - 1) * strip.row_pitch_mm + strip.marker_mm) / 2.0
    facing = np.stack([radius_mm * np.cos(azimuths), radius_mm * np.sin(azimuths), np.full_like(angles, height_mm)], axis=1)
    points = np.array([frames.apply(pose, point) for pose, point in zip(cam_from_canister, facing, strict=True)])
    places = points[:, :2] / points[:, 2:] * points[0, 2]  # across the line of sight, where the measurement is accurate
    terms = np.stack([np.ones_like(angles), np.cos(angles), np.sin(angles)], axis=1)
    wobbles_mm = ECCENTRIC_MM, float(np.hypot(WOBBLE_MM, ECCENTRIC_MM * cam_from_canister[0][2, 2]))  # seen from above, the circle is open
    off_mm, sigmas_mm = np.zeros(2), np.zeros(2)
    for axis, wobble_mm in enumerate(wobbles_mm):
        precision = terms[:-1].T @ terms[:-1] / NOISE_MM**2 + np.diag([0.0, 1.0, 1.0]) / wobble_mm**2
        covariance = np.linalg.inv(precision)
        off_mm[axis] = places[-1, axis] - terms[-1] @ covariance @ terms[:-1].T @ places[:-1, axis] / NOISE_MM**2
        sigmas_mm[axis] = np.sqrt(terms[-1] @ covariance @ terms[-1] + NOISE_MM**2)
    is_beside = (np.abs(off_mm) > np.maximum(SHIFT_MM, SIGMAS * sigmas_mm)).any()
    return float(np.linalg.norm(off_mm)) if is_beside else 0.0
