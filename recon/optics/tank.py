"""Lines of sight through the flat front of a tank around the canister, up to its round wall (float64 reference).

A flat wall conserves the components of the optical direction ``p = n d`` along it, here ``(q_y, q_z)`` in the tank's
frame (that of the rig, rotated by ``turn_deg``; the front's normal is +x): with ``a_i = sqrt(n_i^2 - q_y^2 - q_z^2)``,
a ray that crosses the thickness t of medium i is displaced by ``t q / a_i``. A camera ray given by (q_y, q_z) is
therefore a known straight line in the liquid. In the canister's frame, which may be rotated, tilted and offset, its
``p_z`` and its angular momentum ``L = x p_y - y p_x`` are those that the round walls conserve
(`recon.optics.refraction`). The result is an `Approach`, as for a camera without a tank, independent of the camera's
pose.

The point P lies on the line when ``f1 = P . nu - b_w = 0`` and ``f2 = z(P) - P_z = 0``: two equations for (q_y, q_z),
solved by Newton's method. If a liquid unlike the water gives a point several images, the one nearest to its straight
line is used.
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
"""Maximum number of Newton steps; damped ones may need some near the wall."""
_CLOSE_MM = 1e-8
"""Distance from the point at which a ray has converged."""
DIFFERENCE = 1e-7
"""Step of the central differences in (q_y, q_z): half of double precision's digits."""


@dataclass(frozen=True, kw_only=True)
class TankView:
    """Relative poses of a camera, a tank and a canister in a view."""

    tank: Tank
    centre_mm: Array
    """(3,) centre of the camera, tank's frame."""
    azimuth_from_tank: Array
    """(4, 4) from the tank's frame to that of the lines of sight: the canister's, rotated about its axis."""
    optics: Optics


def in_liquid(tank: Tank, centre_mm: Array, q_y: Array, q_z: Array) -> tuple[Array, Array, Array]:
    """Compute rays from the camera through the front wall.

    Parameters
    ----------
    tank : Tank
        Front wall and indices.
    centre_mm : (..., 3) float64
        Centre of the camera, tank's frame.
    q_y, q_z : (...) float64
        Components of the unit direction in air along the front.

    Returns
    -------
    point : (..., 3) float64
        Points at which rays enter the liquid, tank's frame.
    p : (..., 3) float64
        Optical directions in the liquid.
    front_z : (...) float64
        Height at which they meet the front's outside, mm.
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
    """Compute camera rays through the tank's front.

    Parameters
    ----------
    at : TankView
        The view.
    q_y, q_z : (...) float64
        Components of the unit direction in air along the front.

    Returns
    -------
    line : Approach
        Lines in the liquid.
    through : (...) bool
        Whether the ray passes through the front: below the liquid's surface, above the bottom, between the side walls.
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
    """Compute the lines in the water of camera rays (...) through the tank, and which enter by front and wall."""
    line, through = approach(at, q_y, q_z)
    with np.errstate(invalid="ignore"):
        water = refraction.follow(at.optics, line)
    return water, through & refraction.enters(at.optics, water)


def miss(at: TankView, points_mm: Array, q: Array) -> Array:
    """Return the distances (f1, f2), mm, (N, 2) of rays q (N, 2) from points (N, 3); NaN if they miss the water."""
    line, _ = trace(at, q[:, 0], q[:, 1])
    beside = np.sum(points_mm[:, :2] * line.nu, axis=-1) - line.b_mm
    with np.errstate(invalid="ignore"):
        return np.stack([beside, refraction.height_at(at.optics, line, points_mm[:, :2]) - points_mm[:, 2]], axis=-1)


def slopes(missed: Callable[[Array], Array], q: Array) -> Array:
    """Return the derivatives (N, 2, 2) of the distances (rows) by q (columns)."""
    columns = []
    for k in (0, 1):
        step = np.zeros(2)
        step[k] = DIFFERENCE
        columns.append((missed(q + step) - missed(q - step)) / (2.0 * DIFFERENCE))
    return np.stack(columns, axis=-1)


def find_rays(at: TankView, points_mm: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Find the camera rays that end at points in the water.

    Parameters
    ----------
    points_mm : (N, 3) float64
        Points in the azimuth frame, inside the water's radius.

    Returns
    -------
    q : (N, 2) float64
        Components of the rays' unit directions in air along the tank's front; NaN if no ray ends there.
    visible : (N,) bool
        Whether a ray was found that enters through the front and the wall.

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
    """Move rays that miss the water towards the ray that points at the axis, until they reach it."""
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
