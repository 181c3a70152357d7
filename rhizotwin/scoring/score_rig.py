"""Comparison of self-calibrated rig parameters with the ground truth, in units of their standard deviations."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rhizotwin.recon.calibration.cameras import Camera
from rhizotwin.recon.results.parts import Json
from rhizotwin.scenes import frames
from rhizotwin.scenes.truth import Truth
from rhizotwin.stored.calibration_table import Row, rows

_OF_POSE = {"tilt x": 0, "tilt y": 1, "offset x": 2, "offset y": 3}
"""Index of each tilt and offset in the vector of the canister's pose parameters, keyed by the name in the calibration
table."""


@dataclass(frozen=True, kw_only=True)
class RigError:
    """Error of a rig parameter that was calibrated from the pictures."""

    quantity: str
    """Name of the calibrated rig parameter."""
    found: float
    """Calibrated value of the parameter."""
    true: float
    """True value of the parameter."""
    sigma: float | None
    """Standard deviation in the result. It is None if the result contains no standard deviation."""
    unit: str
    """Unit of the parameter. It is empty for a dimensionless parameter."""

    @property
    def error(self) -> float:
        """Calibrated value minus true value."""
        return self.found - self.true

    @property
    def text(self) -> str:
        """Text with the calibrated value, the true value and the error."""
        sigmas = "" if not self.sigma else f", {abs(self.error) / self.sigma:.1f} standard deviations"
        # two digits of the standard deviation, or else of the error
        digits = max(0, 1 - math.floor(math.log10(self.sigma or abs(self.error) or 1.0)))
        found, true, error = (round(value, digits) + 0.0 for value in (self.found, self.true, self.error))
        return f"{found:.{digits}f}, true {true:.{digits}f}: error {error:+.{digits}f} {self.unit}".rstrip() + sigmas


def compare_rig(rig: Json, cameras: Sequence[Camera], truth: Truth) -> tuple[RigError, ...]:
    """Return the errors of all rig parameters whose true values are known."""
    found = []
    for row in rows(rig):
        true = _true_value(row, truth)
        if true is not None:
            found.append(RigError(quantity=row.quantity, found=row.found, true=true, sigma=row.sigma, unit=row.unit))
    angles = _table_angles(cameras, truth)
    return (*found, *([] if angles is None or "table_correction_deg" not in rig else [angles]))


def _true_value(row: Row, truth: Truth) -> float | None:
    """Return the true value of a calibrated parameter. It is None if the ground truth does not contain it."""
    if row.quantity == "refractive index of the water":
        return truth.n_water
    if row.quantity == "focal length relative to the given value":
        error = truth.drawn.get("focal_error")
        return None if error is None else 1.0 + float(error)
    name, _, what = row.quantity.partition(": ")
    known = {
        "canister relative to the marker strip": truth.canister_from_strip,
        "canister relative to the turntable": truth.drawn.get("table_from_canister"),
    }
    if known.get(name) is None:
        return None
    pose = np.array(known[name])
    return float(np.concatenate([np.rad2deg(frames.to_rotvec(pose)[:2]), pose[:2, 3]])[_OF_POSE[what]])


def _table_angles(cameras: Sequence[Camera], truth: Truth) -> RigError | None:
    """Return the root mean square error of the table angles, deg.

    The mean error of each ring is subtracted, because it is equivalent to a change of the camera's azimuth. Return None
    if no table angle is known.
    """
    true = {view.file: view.table_deg for view in truth.views}
    off: dict[int, list[float]] = {}
    for view in cameras:
        if view.used and view.table_deg is not None and view.file in true:
            off.setdefault(view.ring, []).append((view.table_deg - true[view.file] + 180.0) % 360.0 - 180.0)
    left = np.concatenate([np.zeros(0), *(np.array(ring) - np.mean(ring) for ring in off.values())])
    if not len(left):
        return None
    return RigError(quantity="table angles (rms)", found=float(np.sqrt(np.mean(left**2))), true=0.0, sigma=None, unit="deg")
