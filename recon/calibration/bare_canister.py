"""Calibration of a telecentric scan without markers, from the canister's edges and the consistency of the views.

With parallel straight rays, a camera at the azimuth alpha and the elevation eps projects a point (X, Y, Z) of the
canister to

    u = u_axis + (-X sin alpha + Y cos alpha) / s            column
    v = v_0 - (Z cos eps - (X cos alpha + Y sin alpha) sin eps) / s    row, s in mm per pixel.

The canister's two outer edges determine its axis u_axis and its tilt in every view. Together with the measured
diameter, they also determine the scale s. The table angles follow from three properties of the roots' coverage, without
detecting any root. The total coverage of a row is the same in every view (zeroth moment). The centre of mass of a row
moves like a point that rotates with the table (first moment). The mean square of a row varies like an ellipse (second
moment). These properties are the Helgason-Ludwig conditions of parallel projections (Ludwig 1966, Communications on
Pure and Applied Mathematics 19:49). The zeroth moments also determine the elevation, because nearer points appear lower
in the picture.

Under parallel straight rays, a shape and its mirror image that rotates in the opposite direction produce the same
pictures. The rotation direction of the table must therefore be known.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.calibration import bare_edges, bare_turn
from rhizotwin.recon.calibration.cameras import BareUncertainty
from rhizotwin.scenes import frames
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.picture_codec import Grey

Array = NDArray[np.float64]

LEAST_VIEWS = 12
"""Minimum number of views in a turn. The centre of mass of each row has three unknowns, and each view adds an unknown
angle, so fewer views leave little redundancy."""
MOST_AGREEMENT_PX = 3.0
"""Largest accepted residual of the rows' centres of mass, as a robust standard deviation, px. The centre of mass of
each row is fitted as a point that rotates with the table. Larger residuals indicate refraction, a wrong canister, or a
table that did not turn."""
HEIGHTS_AGREE_MM = 1.0
"""Tolerance for the height of the canister's floor, mm. The user is notified if the height in the pictures and the
height in the scene differ by more. The tolerance exceeds the height of a meniscus."""
CALLIPER_MM = 0.1
"""Standard deviation of a diameter measured with callipers, mm. The resolution of callipers is 0.02 mm, but the wall of
a tube yields by a tenth of a millimetre."""
_OTHER_LENS = (
    "without a marker strip, only the cameras of a telecentric lens can be determined, whose rays are parallel "
    '(camera.kind = "telecentric"). With another lens, print a strip (rhizotwin markers), or import the pictures with '
    "their cameras (rhizotwin import --cameras)."
)
"""Message if the camera is not telecentric."""


@dataclass(frozen=True, kw_only=True)
class BareCanister:
    """Camera poses estimated from pictures without markers."""

    cam_from_canister: tuple[Array, ...]
    """Pose (4, 4) of each view's camera, mm, OpenCV axes. The distance along the optical axis cannot be observed. It is
    set to the planned distance of the scene."""
    mm_per_px: float
    """Scale of the pictures, mm per pixel."""
    azimuth_deg: Array
    """(V,) azimuth of each view's camera in the canister frame, degrees, relative to the first view."""
    elevation_deg: float
    """Angle of the optical axis below the horizon, degrees."""
    floor_z_mm: float | None
    """Height of the canister's floor in the pictures, mm; None if the floor is not visible."""
    uncertainty: BareUncertainty
    """Standard deviations of the estimated cameras."""

    def notes(self, scene: Scene) -> tuple[str, ...]:
        """Return notes for the user: the estimated cameras, and differences between the pictures and the scene."""
        can, step = scene.canister, np.abs(np.diff(np.unwrap(self.azimuth_deg, period=360.0)))
        found = [
            f"the cameras were estimated from the canister's edges and the roots: {self.mm_per_px:.5g} mm per pixel for a diameter of "
            f"{2.0 * can.outer_radius_mm:g} mm, table steps of {step.mean():.2f} +- {step.std():.2f} degrees, and an elevation of "
            f"{self.elevation_deg:.2f} degrees",
            "pictures without markers do not show in which direction the table turned. Check turntable.direction in the scene: "
            "if it is wrong, the result is a mirror image.",
        ]
        if self.floor_z_mm is not None and abs(self.floor_z_mm - can.floor_z_mm) > HEIGHTS_AGREE_MM:
            found.append(
                f"the canister's floor is at z = {self.floor_z_mm:.1f} mm in the pictures, but at {can.floor_z_mm:.1f} mm in the scene"
            )
        return tuple(found)


def find_cameras(pictures: Sequence[Grey], scene: Scene, table_deg: Sequence[float]) -> BareCanister:
    """Estimate the camera pose of every picture of one turn.

    Parameters
    ----------
    pictures : sequence of (H, W) uint8 or uint16 array
        Pictures of a rotating canister, taken by a static telecentric camera.
    scene : Scene
        Scene with the canister's outer radius, the water level, the table's direction, and the planned distance.
    table_deg : sequence of float
        Commanded table angles of the pictures, degrees.

    Raises
    ------
    UserError
        If the camera is not telecentric, if there are too few views, if the canister's edges or the water surface are
        not visible, or if the views are inconsistent.
    """
    if scene.camera.kind != "telecentric":
        raise UserError(_OTHER_LENS)
    if len(pictures) < LEAST_VIEWS:
        raise UserError(f"{len(pictures)} pictures are too few for a calibration without markers, which requires at least {LEAST_VIEWS}")
    stack = np.stack(pictures)
    bare = bare_edges.empty_panel(stack)
    edges, width_sigma_px = bare_edges.find_edges(stack, bare)
    mm_per_px = 2.0 * scene.canister.outer_radius_mm / edges.width_px
    mass, moments = bare_turn.row_moments(stack, bare, edges)
    start = -scene.turntable.direction * np.deg2rad(np.asarray(table_deg, np.float64) - table_deg[0])
    azimuth, azimuth_sigma, place, agreement = bare_turn.find_turn(moments, mass, start)
    if agreement > MOST_AGREEMENT_PX:
        raise UserError(
            f"the roots in the pictures do not rotate like a rigid body (deviation {agreement:.1f} px, limit {MOST_AGREEMENT_PX:g} px). "
            "The liquid around the canister may have the wrong refractive index, the table's steps may be uneven, or the plan may be wrong."
        )
    lean = np.cos(azimuth)[:, None] * [0.0, 1.0] - np.sin(azimuth)[:, None] * [1.0, 0.0]  # horizontal axis of each view in (X, Y)
    slope = np.column_stack([np.ones(len(azimuth)), -lean])
    _, tilt_x, tilt_y = np.linalg.lstsq(slope, edges.axis_px[:, 1], rcond=None)[0]
    nearer = np.cos(azimuth)[:, None] * place[0] + np.sin(azimuth)[:, None] * place[1]
    shift, shift_sigma_px, elevation = bare_turn.find_lift(mass, nearer)
    towards = tilt_x * np.cos(azimuth) + tilt_y * np.sin(azimuth)
    level_row = edges.rows[0] - 0.5
    zero_row = level_row + scene.water.level_mm / mm_per_px
    rows, (column, slant) = zero_row + shift, edges.axis_px.T
    columns = column + slant * (rows - edges.middle)
    views = zip(azimuth, elevation + towards, np.arctan(slant), zip(columns, rows, strict=True), strict=True)
    poses = tuple(_pose(scene, mm_per_px, *view) for view in views)
    return BareCanister(
        cam_from_canister=poses,
        mm_per_px=mm_per_px,
        azimuth_deg=np.rad2deg(azimuth),
        elevation_deg=float(np.rad2deg(elevation)),
        floor_z_mm=-(edges.rows[1] - 0.5 - zero_row) * mm_per_px if edges.floor_seen else None,
        uncertainty=BareUncertainty(
            scale=float(np.hypot(width_sigma_px / edges.width_px, CALLIPER_MM / (2.0 * scene.canister.outer_radius_mm))),
            azimuth_rad=float(np.sqrt(np.mean(azimuth_sigma**2))),
            lift_mm=float(np.sqrt(np.mean(shift_sigma_px**2))) * mm_per_px,
            mm_per_px=mm_per_px,
        ),
    )


def _pose(scene: Scene, mm_per_px: float, azimuth: float, elevation: float, lean: float, origin_px: tuple[float, float]) -> Array:
    """Return the pose (4, 4) of a camera, computed from its azimuth and elevation, rad.

    The roll ``lean``, rad, and the lateral shift, given as the pixel of the canister's origin, are determined by the
    canister's edges.
    """
    level = frames.level_camera(distance_mm=0.0, height_mm=0.0, tilt_deg=float(np.rad2deg(elevation)))
    pose = frames.rotation_z(-lean) @ level @ frames.rotation_z(-azimuth)
    pose[:2, 3], pose[2, 3] = mm_per_px * (np.array(origin_px) - scene.camera.principal_px), scene.plan.rings[0].distance_mm
    return np.asarray(pose)
