"""Lines of sight through the flat front of a tank, up to the round wall of the canister in it (float64 reference).

A flat wall conserves the components of the optical direction ``p = n d`` along the wall. Here, these are ``(q_y, q_z)``
in the tank's frame, which is the rig's frame rotated by ``turn_deg``, with the front's normal along +x. With ``a_i =
sqrt(n_i^2 - q_y^2 - q_z^2)``, a ray that crosses a thickness t of medium i is displaced by ``t q / a_i``. A camera ray
defined by (q_y, q_z) is therefore a known straight line in the liquid. The canister's frame may be rotated, tilted and
offset. The line's ``p_z`` and angular momentum ``L = x p_y - y p_x`` in this frame are conserved by the round walls
(`recon.optics.refraction`). As for a camera without a tank, the result is an `Approach`, which does not depend on the
camera's pose.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.optics.refraction import Approach, Array, Optics
from rhizotwin.scenes import frames
from rhizotwin.scenes.model import Tank


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
