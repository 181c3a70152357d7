"""Compare what the pictures told of the rig with the truth, each quantity in its own standard deviations."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rhizotwin.recon.calibration.cameras import Camera
from rhizotwin.recon.results.parts import Json
from rhizotwin.scenes import frames
from rhizotwin.scenes.truth import Truth
from rhizotwin.stored.calibration_table import Row, rows

_OF_POSE = {"tilt x": 0, "tilt y": 1, "offset x": 2, "offset y": 3}
"""Place of each quantity among tilts and offsets."""


@dataclass(frozen=True, kw_only=True)
class RigError:
    """A quantity that was calibrated from the pictures against the truth."""

    quantity: str
    found: float
    true: float
    sigma: float | None
    """Standard deviation that the result states."""
    unit: str

    @property
    def error(self) -> float:
        """Return found less true."""
        return self.found - self.true

    @property
    def text(self) -> str:
        """Return the comparison as words."""
        sigmas = "" if not self.sigma else f", {abs(self.error) / self.sigma:.1f} standard deviations"
        return f"{self.found:.6g}, true {self.true:.6g}: off by {self.error:+.2g} {self.unit}".rstrip() + sigmas


def compare_rig(rig: Json, cameras: Sequence[Camera], truth: Truth) -> tuple[RigError, ...]:
    """Return the errors of those quantities of a result's rig that the truth knows."""
    found = []
    for row in rows(rig):
        true = _true(row, truth)
        if true is not None:
            found.append(RigError(quantity=row.quantity, found=row.found, true=true, sigma=row.sigma, unit=row.unit))
    angles = _table_angles(cameras, truth)
    return (*found, *([] if angles is None or not rig else [angles]))


def _true(row: Row, truth: Truth) -> float | None:
    """Return a row's true value; None where the truth does not know it."""
    if row.quantity == "index of the water":
        return truth.n_water
    if row.quantity == "focal length over the given":
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
    """Return how far the table angles are off (root mean square), their common part taken out.

    The camera's azimuth takes that up.
    """
    true = {view.file: view.table_deg for view in truth.views}
    off: dict[int, list[float]] = {}
    for view in cameras:
        if view.used and view.table_deg is not None and view.file in true:
            off.setdefault(view.ring, []).append((view.table_deg - true[view.file] + 180.0) % 360.0 - 180.0)
    left = np.concatenate([np.zeros(0), *(np.array(ring) - np.mean(ring) for ring in off.values())])
    if not len(left):
        return None
    return RigError(quantity="table angles, rms", found=float(np.sqrt(np.mean(left**2))), true=0.0, sigma=None, unit="deg")
