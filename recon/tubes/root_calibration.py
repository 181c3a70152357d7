"""Calibration from the roots: refractive index of the water, and corrections of cameras and canister.

Roots are visible in all views and at all distances from the axis. An incorrect refractive index displaces them in the
pictures in a pattern that no shape, and hardly any camera error, can reproduce. The parameters are the refractive
index, the focal length, the pose of the canister in the strip, the camera of each station, and the table angle of each
view. The covariances from the markers are used as the prior.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.calibration.cameras import Cameras, RootCalibration
from rhizotwin.recon.optics.cameras import View
from rhizotwin.recon.optics.refraction import Optics
from rhizotwin.recon.robust import inverse
from rhizotwin.recon.tubes import rig_derivatives, view_correction
from rhizotwin.recon.tubes.rig_derivatives import QUANTITIES
from rhizotwin.recon.tubes.rig_equations import Columns, Correction
from rhizotwin.recon.tubes.view_correction import Viewed

Array = NDArray[np.float64]

INDEX_PRIOR = 0.003
"""Prior standard deviation of the water's refractive index.

For comparison, ten degrees change the index by 0.001, 2 g/l of salts by 0.0003, and red or blue light by 0.002."""
LEAST_TURN_RAD = 1e-5
"""Minimum standard deviation of a table angle, rad. In pictures of 800x600 px, markers determine the angle to 7e-5
rad."""
INDEX_LIMITS = 1.32, 1.36
"""Minimum and maximum of the estimated refractive index, which are those of hot water and of salty water."""
SURE = 3.0
"""Minimum deviation of the estimated from the given refractive index, in standard deviations, for the estimate to be
used."""
LEAST_GAIN = 0.04
"""Minimum relative reduction of the lateral distance between the centre lines in the pictures and those of the fitted
tubes. The estimated refractive index is used only if the reduction is larger.

On a radish, the correction of an index error of 0.0006 reduced the distance by 0.5 %. The reduction is proportional to
the square of the error, so that this limit corresponds to 0.0018. Wide roots that are not quite round bias the index:
for a printed phantom, the estimate is 0.0013 too high with 4.5 standard deviations, and the reduction is 1.3 %.
The reduction is computed from the linear system, since refitting the tubes reduces the distance by some per cent with
any index, depending on the rounding of the pictures."""
_SETTLED = 0.2
"""Change of the refractive index between two refits below which the iteration has converged, in standard deviations."""


def calibrate(given: Viewed) -> Viewed:
    """Estimate the refractive index from fitted tubes.

    If the estimate is significant, index and cameras are updated and the tubes are refitted until convergence. The
    initial values are kept if this does not reduce the residuals.

    Returns
    -------
    Viewed
        Resulting views, and the tubes fitted to them. The attribute ``roots`` of the cameras is the estimate, or None
        if there are too few nodes.
    """
    cameras = given.cameras

    def apply(value: Array) -> Cameras:
        return apply_change(cameras, value)

    def accept(found: list[Correction]) -> bool:
        if len(found) == 1:
            return is_significant(found[0], cameras.optics)
        return abs(float(found[-1].value[0] - found[-2].value[0])) > _SETTLED * float(found[-1].sigma[0])

    now, found = view_correction.correct(given, rig_columns(cameras), apply, accept)
    if not found:
        return given
    sure, first, last = now is not given, found[0], found[-1]
    calibration = RootCalibration(
        n_water=now.cameras.optics.n_water if sure else cameras.optics.n_water + float(first.value[0]),
        n_water_sigma=float(last.sigma[0]),
        n_water_given=cameras.optics.n_water,
        focal_scale=now.cameras.lens.focal_px[0] / cameras.lens.focal_px[0],
        believed=sure,
        nodes=first.nodes,
        before_px=first.before_px,
        after_px=last.after_px,
    )
    return replace(now, cameras=replace(now.cameras, roots=calibration))


def rig_columns(cameras: Cameras) -> Columns:
    """Return all parameters of the rig, as changes from their values in ``cameras``.

    If the uncertainty of the cameras is unknown, only the refractive index is estimated.
    """
    known, order, views = cameras.uncertainty, list(cameras.order), np.arange(len(cameras.order))
    if known is None:
        return Columns.build(QUANTITIES[:1], np.zeros((len(views), 1), np.int64), np.zeros(1), np.array([[INDEX_PRIOR**-2.0]]), 1)
    shared = 6 + 6 * known.stations
    index = np.tile(np.arange(len(QUANTITIES)), (len(views), 1))
    index[:, 6] = shared + views
    index[:, 7:] = 6 + 6 * known.station[order][:, None] + np.arange(6)
    precision = np.diag(np.concatenate([np.zeros(shared), np.maximum(known.turn[order], LEAST_TURN_RAD) ** -2.0]))
    precision[0, 0] = INDEX_PRIOR**-2.0
    precision[1:shared, 1:shared] = inverse(known.covariance)
    return Columns.build(QUANTITIES, index, np.zeros(len(precision)), precision, shared)


def is_significant(found: Correction, optics: Optics) -> bool:
    """Return whether the refractive index estimated from the roots is significant and within its limits."""
    change = float(found.value[0])
    sure = abs(change) > SURE * float(found.sigma[0]) and INDEX_LIMITS[0] < optics.n_water + change < INDEX_LIMITS[1]
    return sure and found.after_px < (1.0 - LEAST_GAIN) * found.before_px


def apply_change(cameras: Cameras, change: Array) -> Cameras:
    """Return the cameras after the unknowns have changed by ``change`` (K,)."""
    optics = replace(cameras.optics, n_water=cameras.optics.n_water + float(change[0]))
    known = cameras.uncertainty
    if known is None:
        return replace(cameras, optics=optics)
    stations = known.stations
    camera, turn = change[6 : 6 + 6 * stations].reshape(-1, 6), change[6 + 6 * stations :]

    def move(frame: int, view: View, turn_rad: float) -> View:
        canister = np.array([change[2], change[3], turn_rad, change[4], change[5], 0.0])
        view = rig_derivatives.move_camera(rig_derivatives.move_canister(view, canister), camera[known.station[frame]])
        return replace(view, camera=view.camera.focused(1.0 + float(change[1])))

    held_out = replace(cameras, order=tuple(cameras.held_out))  # their table angles have no estimate from the roots
    held_out = held_out.with_views([move(frame, view, 0.0) for frame, view in zip(held_out.order, held_out.views, strict=True)], optics)
    moved = [move(frame, view, turn[v]) for v, (frame, view) in enumerate(zip(cameras.order, cameras.views, strict=True))]
    return replace(cameras, all=held_out.all).with_views(moved, optics)
