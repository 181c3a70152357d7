"""Lines of sight through the flat front of a tank, up to the round wall of the canister in it (float64 reference).

A flat wall conserves the components of the optical direction ``p = n d`` along the wall. Here, these are ``(q_y, q_z)``
in the tank's frame, which is the rig's frame rotated by ``turn_deg``, with the front's normal along +x. With ``a_i =
sqrt(n_i^2 - q_y^2 - q_z^2)``, a ray that crosses a thickness t of medium i is displaced by ``t q / a_i``. A camera ray
defined by (q_y, q_z) is therefore a known straight line in the liquid. The canister's frame may be rotated, tilted and
offset. The line's ``p_z`` and angular momentum ``L = x p_y - y p_x`` in this frame are conserved by the round walls
(`recon.optics.refraction`). As for a camera without a tank, the result is an `Approach`, which does not depend on the
camera's pose.

The point P lies on the line if ``f1 = P . nu - b_w = 0`` and ``f2 = z(P) - P_z = 0``. These two equations are solved
for (q_y, q_z) by Newton's method. If the refractive indices of liquid and water differ, a point may have several
images. The image nearest to the straight line to the point is then used.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.optics import refraction
from rhizotwin.recon.optics.refraction import Approach, Array, Optics, WaterLine
from rhizotwin.scenes import frames
from rhizotwin.scenes.model import Tank

_STEPS = 30
"""Maximum number of Newton steps. Damped steps near the wall converge slowly."""
_CLOSE_MM = 1e-8
"""Distance of a ray from the point below which the ray has converged, mm."""
DIFFERENCE = 1e-7
"""Step of central differences in (q_y, q_z). The step keeps half of the digits of double precision."""


@dataclass(frozen=True, kw_only=True)
class TankView:
    """Relative poses of the camera, the tank and the canister in a view."""

    tank: Tank
    """Dimensions and refractive indices of the tank."""
    centre_mm: Array
    """(3,) camera centre in the tank's frame, mm."""
    azimuth_from_tank: Array
    """(4, 4) transform from the tank's frame to the azimuth frame, which is the canister frame rotated about its axis.
    """
    optics: Optics
    """Optics of the canister in the tank."""


def in_liquid(tank: Tank, centre_mm: Array, q_y: Array, q_z: Array) -> tuple[Array, Array, Array]:
    """Trace camera rays through the front wall of a tank into the liquid.

    Parameters
    ----------
    tank : Tank
        Position, thickness and refractive indices of the front wall.
    centre_mm : (..., 3) float64
        Camera centre in the tank's frame, mm.
    q_y, q_z : (...) float64
        Components of the unit direction in air along the front.

    Returns
    -------
    point : (..., 3) float64
        Points at which the rays enter the liquid, tank's frame, mm.
    p : (..., 3) float64
        Optical directions in the liquid.
    front_z : (...) float64
        Heights at which the rays meet the outside of the front, mm.
    """
    x, y, z = np.moveaxis(centre_mm, -1, 0)
    q2 = q_y**2 + q_z**2
    with np.errstate(invalid="ignore", divide="ignore"):
        a_air, a_wall, a_liquid = (np.sqrt(n**2 - q2) for n in (1.0, tank.n_wall, tank.n_liquid))
    aside = (x - tank.front_mm) / a_air + tank.wall_mm / a_wall
    point = np.stack([np.full(np.shape(aside), tank.front_mm - tank.wall_mm), y + aside * q_y, z + aside * q_z], axis=-1)
    p = np.stack([-a_liquid, np.broadcast_to(q_y, a_liquid.shape), np.broadcast_to(q_z, a_liquid.shape)], axis=-1)
    return point, p, z + (x - tank.front_mm) / a_air * q_z


def approach(at: TankView, q_y: Array, q_z: Array) -> tuple[Approach, NDArray[np.bool_]]:
    """Trace camera rays through the front of a tank up to the canister.

    Parameters
    ----------
    at : TankView
        Relative poses of the view.
    q_y, q_z : (...) float64
        Components of the unit direction in air along the front.

    Returns
    -------
    line : Approach
        Lines of sight in the liquid.
    through : (...) bool
        Whether each ray passes through the front below the liquid's surface, above the bottom, and between the side
        walls.
    """
    tank = at.tank
    inside, p, front_z = in_liquid(tank, at.centre_mm, q_y, q_z)
    point = frames.apply(at.azimuth_from_tank, inside)
    p_x, p_y, p_z = np.moveaxis(p @ at.azimuth_from_tank[:3, :3].T, -1, 0)
    with np.errstate(invalid="ignore"):
        h2 = tank.n_liquid**2 - p_z**2
        b = (point[..., 0] * p_y - point[..., 1] * p_x) / np.sqrt(h2)
        foot_z = point[..., 2] - p_z * (point[..., 0] * p_x + point[..., 1] * p_y) / h2
        through = np.abs(inside[..., 1]) < tank.half_width_mm - tank.wall_mm
        for height in (front_z, inside[..., 2]):
            through &= (height < tank.level_mm) & (height > at.optics.bottom_z_mm)
    return Approach(b_mm=b, p_z=p_z, heading_rad=np.arctan2(p_y, p_x), foot_z_mm=foot_z), through


def trace(at: TankView, q_y: Array, q_z: Array) -> tuple[WaterLine, NDArray[np.bool_]]:
    """Trace camera rays (...) through the tank into the water.

    Return the lines in the water, and whether each ray enters through the front and the wall.
    """
    line, through = approach(at, q_y, q_z)
    with np.errstate(invalid="ignore"):
        water = refraction.follow(at.optics, line)
    return water, through & refraction.enters(at.optics, water)


def miss(at: TankView, points_mm: Array, q: Array) -> Array:
    """Return the distances (N, 2) by which rays q (N, 2) miss points (N, 3), mm.

    The two distances are f1 and f2. They are NaN if the ray misses the water.
    """
    line, _ = trace(at, q[:, 0], q[:, 1])
    beside = np.sum(points_mm[:, :2] * line.nu, axis=-1) - line.b_mm
    with np.errstate(invalid="ignore"):
        return np.stack([beside, refraction.height_at(at.optics, line, points_mm[:, :2]) - points_mm[:, 2]], axis=-1)


def slopes(missed: Callable[[Array], Array], q: Array) -> Array:
    """Return the derivatives (N, 2, 2) of the distances (rows) with respect to the components of q (columns)."""
    columns = []
    for k in (0, 1):
        step = np.zeros(2)
        step[k] = DIFFERENCE
        columns.append((missed(q + step) - missed(q - step)) / (2.0 * DIFFERENCE))
    return np.stack(columns, axis=-1)


def find_rays(at: TankView, points_mm: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Find the camera rays to points in the water.

    Parameters
    ----------
    points_mm : (N, 3) float64
        Points in the azimuth frame, mm, within the radius of the water.

    Returns
    -------
    q : (N, 2) float64
        Components of the rays' unit directions in air along the tank's front; NaN if no ray reaches the point.
    visible : (N,) bool
        Whether a ray through the front and the wall was found.

    Notes
    -----
    The initial value is the straight line of the same apparent depth behind the front, with the index of the liquid for
    all media. A step that would lead to a ray that misses the water, or farther from the point, is halved.
    """
    in_tank = frames.apply(frames.invert(at.azimuth_from_tank), points_mm)
    x, y, z = at.centre_mm
    depth = (
        x - at.tank.front_mm + at.tank.wall_mm / at.tank.n_wall + (at.tank.front_mm - at.tank.wall_mm - in_tank[:, 0]) / at.tank.n_liquid
    )
    aside = in_tank[:, 1:] - [y, z]
    q = aside / np.sqrt(depth**2 + np.sum(aside**2, axis=1))[:, None]

    q = _pull_inside(at, q, points_mm)
    left = np.arange(len(q))  # not converged yet
    for _ in range(_STEPS):
        here = points_mm[left]
        f = miss(at, here, q[left])
        size = np.linalg.norm(f, axis=1)
        going = size > _CLOSE_MM  # excludes rays that miss the water
        if not going.any():
            break
        left, here, f, size = left[going], here[going], f[going], size[going]
        slope = slopes(partial(miss, at, here), q[left])
        good = np.asarray(np.isfinite(slope).all(axis=(1, 2)))
        good[good] &= np.abs(np.linalg.det(slope[good])) > 1e-9
        step = np.zeros_like(f)
        step[good] = np.linalg.solve(slope[good], f[good][..., None])[..., 0]
        share = np.ones(len(left))
        for _ in range(8):
            trial = q[left] - share[:, None] * step
            worse = ~(np.linalg.norm(miss(at, here, trial), axis=1) <= size)
            if not (worse & good).any():
                break
            share[worse] *= 0.5
        q[left[~worse]] = trial[~worse]
    f = miss(at, points_mm, q)
    visible = (np.linalg.norm(f, axis=1) < 1e2 * _CLOSE_MM) & trace(at, q[:, 0], q[:, 1])[1]
    return np.where(visible[:, None], q, np.nan), visible


def _pull_inside(at: TankView, q: Array, points_mm: Array) -> Array:
    """Move rays that miss the water towards the ray through the axis, until they reach the water."""
    middle = frames.apply(frames.invert(at.azimuth_from_tank), np.array([[0.0, 0.0, at.optics.floor_z_mm]]))[0]
    x, y, _ = at.centre_mm
    aim = (middle[1] - y) / np.hypot(x - middle[0], middle[1] - y)
    q = q.copy()
    for _ in range(40):
        out = ~np.isfinite(miss(at, points_mm, q)).all(axis=1)
        if not out.any():
            break
        q[out, 0] = aim + 0.95 * (q[out, 0] - aim)  # 40 steps leave an eighth of the distance
    return q
