"""Confine growing roots to the water.

Roots turn along the wall, the floor and the grid of the net pot.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rhizotwin.scenes.model import Canister, NetPot
from rhizotwin.scenes.specimens import GrownSpecimen

Array = NDArray[np.float64]

WALL_TURN_MM = 6.0
"""Radius of the arc on which a root turns away from a wall or another limit, mm."""


@dataclass(frozen=True, kw_only=True)
class Bounds:
    """Limits of the positions of root surfaces, canister frame."""

    radius_mm: float
    """Maximum distance of a root surface from the canister's axis, mm."""
    low_z_mm: float
    """Minimum height of a root surface, mm, canister frame."""
    high_z_mm: float
    """Maximum height of a root surface, mm, canister frame."""


def bounds(specimen: GrownSpecimen, *, canister: Canister, net_pot: NetPot) -> Bounds:
    """Return the limits of the positions of a specimen's root surfaces.

    They are the limits of the water below the grid, reduced by the margins that the specimen specifies.

    Parameters
    ----------
    specimen : GrownSpecimen
        Specimen with its margins.
    canister, net_pot : Canister, NetPot
        Canister and net pot that enclose the water.

    Returns
    -------
    Bounds
        Limits of root surfaces.
    """
    return Bounds(
        radius_mm=canister.inner_radius_mm - specimen.wall_margin_mm,
        low_z_mm=canister.floor_z_mm + specimen.floor_margin_mm,
        high_z_mm=net_pot.grid_z_mm - specimen.top_margin_mm,
    )


def steer(points_mm: Array, heading: Array, radii_mm: Array, limits: Bounds) -> Array:
    """Deflect the growth directions (N, 3) of roots near the limits.

    The root tips then move on an arc of radius `WALL_TURN_MM` that is tangent to the limit.

    Parameters
    ----------
    points_mm : (N, 3) array
        Root tips, mm, canister frame.
    heading : (N, 3) array
        Unit vectors of the growth direction.
    radii_mm : (N,) array
        Radii of the roots at their tips, mm.
    limits : Bounds
        Limits of root surfaces.

    Returns
    -------
    (N, 3) array
        Unit vectors of the deflected growth direction.
    """
    radius_mm = np.hypot(points_mm[:, 0], points_mm[:, 1])
    azimuth_rad = np.arctan2(points_mm[:, 1], points_mm[:, 0])
    outward = np.stack([np.cos(azimuth_rad), np.sin(azimuth_rad)], axis=1)
    around = np.stack([-outward[:, 1], outward[:, 0]], axis=1)
    local = np.stack([np.sum(heading[:, :2] * outward, axis=1), np.sum(heading[:, :2] * around, axis=1), heading[:, 2]], axis=1)

    def fastest(gap_mm: Array) -> Array:
        return np.sqrt(1.0 - (1.0 - np.clip(gap_mm / WALL_TURN_MM, 0.0, 1.0)) ** 2)

    out_max = fastest(limits.radius_mm - radii_mm - radius_mm)
    down_max = fastest(points_mm[:, 2] - limits.low_z_mm - radii_mm)
    up_max = fastest(limits.high_z_mm - radii_mm - points_mm[:, 2])
    for _ in range(4):
        limited = local.copy()
        limited[:, 0] = np.minimum(local[:, 0], out_max)
        limited[:, 2] = np.clip(local[:, 2], -down_max, up_max)
        length = np.linalg.norm(limited, axis=1)
        # roots perpendicular to the limit turn along the limit
        limited[:, 1] = np.where(length < 0.1, np.copysign(1.0, local[:, 1]), limited[:, 1])
        local = limited / np.linalg.norm(limited, axis=1, keepdims=True)
    return np.concatenate([local[:, :1] * outward + local[:, 1:2] * around, local[:, 2:]], axis=1)


def keep_inside(points_mm: Array, radii_mm: Array, limits: Bounds) -> Array:
    """Move points (N, 3) that lie beyond the limits back to the limits.

    Points can lie beyond them because the growth steps are finite.

    Parameters
    ----------
    points_mm : (N, 3) array
        Points of centre lines, mm, canister frame.
    radii_mm : (N,) array
        Radii of the roots at these points, mm.
    limits : Bounds
        Limits of root surfaces.

    Returns
    -------
    (N, 3) array
        Points within the limits, mm.
    """
    radius_mm = np.hypot(points_mm[:, 0], points_mm[:, 1])
    shrink = np.minimum(1.0, (limits.radius_mm - radii_mm) / np.maximum(radius_mm, 1e-9))
    z_mm = np.clip(points_mm[:, 2], limits.low_z_mm + radii_mm, limits.high_z_mm - radii_mm)
    return np.concatenate([points_mm[:, :2] * shrink[:, None], z_mm[:, None]], axis=1)
