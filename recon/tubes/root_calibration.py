"""Calibration from the roots: refractive index of the water, and corrections of cameras and canister.

Roots are visible in all views and at all distances from the axis. An incorrect refractive index displaces them in the
pictures in a pattern that no shape, and hardly any camera error, can reproduce. `rig_equations` sets up equations for
the refractive index, the focal length, the pose of the canister in the strip, the camera of each station, and the table
angle of each view. The covariances from the markers are used as the prior.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.calibration.cameras import Cameras, RootCalibration
from rhizotwin.recon.coverage.evidence import Evidence
from rhizotwin.recon.optics.cameras import View
from rhizotwin.recon.optics.refraction import Optics
from rhizotwin.recon.tubes import rig_derivatives, tube_fit
from rhizotwin.recon.tubes.rig_derivatives import QUANTITIES
from rhizotwin.recon.tubes.rig_equations import Columns, build_system
from rhizotwin.recon.tubes.tubes import Tubes

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

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
_ROUNDS, _STEPS = 4, 3
"""Maximum number of refits of the tubes, and number of iterations of each refit."""
_SETTLED = 0.2
"""Change of the refractive index between two refits below which the iteration has converged, in standard deviations."""


@dataclass(frozen=True)
class RigCorrection:
    """Corrections of the rig, estimated from the roots."""

    change: Array
    """Change of each unknown, shape (K,), relative to the calibration from the markers and the canister's edges."""
    sigma: Array
    """Standard deviation of each unknown, shape (K,)."""
    nodes: int
    before_px: float
    """RMS distance in the pictures, perpendicular to the root, between roots and fitted tubes before the correction,
    px. It is evaluated with each node at its best-fitting position."""
    after_px: float
    """Root mean square lateral distance in the pictures between roots and fitted tubes, px, after the correction."""


def calibrate(evidence: Evidence, cameras: Cameras, tubes: Tubes, thick: Mask) -> tuple[Evidence, Tubes, Cameras]:
    """Estimate the refractive index from fitted tubes.

    If the estimate is significant, index and cameras are updated and the tubes are refitted until convergence. The
    initial values are kept if this does not reduce the residuals.

    Parameters
    ----------
    evidence : Evidence
        Measured coverage of the views of ``cameras``, in the same order.
    thick : (N,) bool array
        Same as in `tube_fit.fit`.

    Returns
    -------
    evidence : Evidence
        Measured coverage with the resulting cameras and optics.
    tubes : Tubes
        Tubes fitted to the coverage with these cameras.
    cameras : Cameras
        Resulting cameras. Their attribute ``roots`` is the estimate, or None if there are too few nodes.
    """
    first = estimate(evidence, cameras, tubes)
    if first is None:
        return evidence, tubes, cameras
    given, found, now = (evidence, tubes), first, cameras
    if sure := is_significant(first, cameras.optics):
        for _ in range(_ROUNDS):
            now = apply_change(cameras, found.change)
            evidence = evidence.with_cameras(now)
            tubes = tube_fit.fit(evidence, tubes, thick, steps=_STEPS).tubes
            last = found
            found = estimate(evidence, now, tubes, taken=last.change) or last
            if abs(found.change[0] - last.change[0]) < _SETTLED * found.sigma[0]:
                break
        if found.after_px > first.before_px:
            sure, (evidence, tubes), found, now = False, given, first, cameras
    calibration = RootCalibration(
        n_water=now.optics.n_water if sure else cameras.optics.n_water + float(found.change[0]),
        n_water_sigma=float(found.sigma[0]),
        n_water_given=cameras.optics.n_water,
        focal_scale=now.lens.focal_px[0] / cameras.lens.focal_px[0],
        believed=sure,
        nodes=first.nodes,
        before_px=first.before_px,
        after_px=found.after_px,
    )
    return evidence, tubes, replace(now, roots=calibration)


def estimate(evidence: Evidence, cameras: Cameras, tubes: Tubes, *, taken: Array | None = None) -> RigCorrection | None:
    """Estimate corrections of the rig from fitted tubes.

    The result is None if there are too few nodes.

    Parameters
    ----------
    taken : (K,) float64 array or None
        Changes that were already applied to the cameras, relative to the estimate from markers and edges.
    """
    known = cameras.uncertainty
    columns, wanted = Columns.for_rig(cameras.order, known), QUANTITIES if known is not None else QUANTITIES[:1]
    found = build_system(evidence, cameras, tubes, wanted, columns)
    if found is None:
        return None
    before = np.zeros(len(columns.precision)) if taken is None else taken
    more, covariance = found.solve(before)
    return RigCorrection(
        change=before + more,
        sigma=np.sqrt(np.diag(covariance)),
        nodes=len(found.start),
        before_px=found.distance_px(np.zeros_like(more)),
        after_px=found.distance_px(more),
    )


def is_significant(found: RigCorrection, optics: Optics) -> bool:
    """Return whether the refractive index estimated from the roots is significant and within its limits."""
    estimated = optics.n_water + float(found.change[0])
    sure = abs(float(found.change[0])) > SURE * float(found.sigma[0])
    return sure and found.after_px < (1.0 - LEAST_GAIN) * found.before_px and INDEX_LIMITS[0] < estimated < INDEX_LIMITS[1]


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
