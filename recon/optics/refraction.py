"""Closed-form refraction at a cylindrical canister: the readable reference implementation in float64 NumPy.

Refraction at concentric cylinders about z conserves two invariants of a ray with the optical direction vector ``p = n
d`` (``|p| = n``). The invariants are ``p_z`` and the angular momentum ``L = x p_y - y p_x`` (Bouguer's formula). With
``h_i = sqrt(n_i^2 - p_z^2)``, the ray's horizontal impact parameter in medium i is ``b_i = L / h_i``. Between the
radii r1 > r2, the ray covers the horizontal length ``s_i = sqrt(r1^2 - b_i^2) - sqrt(r2^2 - b_i^2)`` and rises by
``p_z / h_i * s_i``. At a wall of radius r, its horizontal heading turns by ``asin(b_i / r) - asin(b_j / r)``.

All functions use the camera's azimuth frame, which is the canister frame rotated about z such that the camera centre is
at (rho, 0, z_cam). A camera without a tank is then defined by (rho, z_cam). The unknowns of a projection are ``p_z``
and ``w = b_air / R_o``, which lies in (-1, 1) for every ray that meets the canister. Through the flat wall of a tank,
lines of sight do not originate from one point. `recon.optics.tank` computes these lines in the liquid (`Approach`), and
from there on the equations are the same. `recon.optics.cameras` solves for the ray through a point.

`recon.optics.projection` implements the same mathematics as a Dr.Jit kernel. A test compares both implementations.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rhizotwin.scenes.model import Scene, Tank

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Optics:
    """Optical properties of the canister, the water, and a tank."""

    outer_radius_mm: float
    """Outer radius of the canister, mm."""
    inner_radius_mm: float
    """Inner radius of the canister, mm."""
    n_wall: float
    """Refractive index of the canister's wall."""
    n_water: float
    """Refractive index of the water."""
    floor_z_mm: float
    """Lowest height at which a ray may enter the water, mm."""
    water_z_mm: float
    """Highest height at which a ray may enter the water, mm."""
    bottom_z_mm: float
    """Lowest height at which a ray may enter the wall, mm, which is the underside of the canister."""
    tank: Tank | None = None
    """Tank around the canister; None if there is no tank."""
    unobstructed: bool = False
    """Whether neither canister nor water exists, so that rays are straight and reach the roots from all directions. The
    other values then only bound the space of the roots."""

    @property
    def straight(self) -> bool:
        """Return whether rays are straight because wall and water have the refractive index of the surroundings."""
        return self.tank is None and self.n_wall == self.n_water == 1.0

    @property
    def n_around(self) -> float:
        """Return the refractive index of the medium around the canister."""
        return 1.0 if self.tank is None else self.tank.n_liquid

    @property
    def w_limit(self) -> float:
        """Return the largest impact parameter of rays that reach the water, as a fraction of the outer radius.

        The impact parameter is that outside the canister. In air, the limit is 1 unless a refractive index is close to
        1.
        """
        to_water = self.inner_radius_mm / self.outer_radius_mm * min(self.n_wall, self.n_water) / self.n_around
        return min(1.0, to_water) * (1.0 - 1e-9)

    @staticmethod
    def from_scene(scene: Scene) -> "Optics":
        """Return the optics of the canister, the water and the tank in a scene."""
        can, around = scene.canister, scene.surroundings.n
        return Optics(
            outer_radius_mm=can.outer_radius_mm,
            inner_radius_mm=can.inner_radius_mm,
            n_wall=can.n_wall / around,  # only ratios bend rays
            n_water=scene.water.n_water / around,
            floor_z_mm=can.floor_z_mm,
            water_z_mm=min(scene.water.level_mm, scene.net_pot.grid_z_mm),
            bottom_z_mm=-can.height_mm,
            tank=scene.tank,
        )


class _HeadedLines:
    """Base class of straight lines whose horizontal direction is given by an azimuth (heading)."""

    heading_rad: Array
    """Azimuth of the horizontal direction, rad."""

    @property
    def t(self) -> Array:
        """Return the horizontal unit directions (..., 2)."""
        return np.stack([np.cos(self.heading_rad), np.sin(self.heading_rad)], axis=-1)

    @property
    def nu(self) -> Array:
        """Return the horizontal unit normals (..., 2), with P . nu = b for points P on the line."""
        return np.stack([np.sin(self.heading_rad), -np.cos(self.heading_rad)], axis=-1)


@dataclass(frozen=True, kw_only=True)
class Approach(_HeadedLines):
    """Straight lines of sight outside the canister, in the camera's azimuth frame."""

    b_mm: Array
    """(...) impact parameter, which is the signed distance from the axis, mm."""
    p_z: Array
    """(...) vertical component of the optical direction, whose length is the refractive index of the surroundings."""
    heading_rad: Array
    """(...) azimuth of the horizontal direction, rad."""
    foot_z_mm: Array
    """(...) height of the point at which the extended line is nearest to the axis, mm."""


def reach_mm(optics: Optics, p_z: Array) -> Array:
    """Return the largest impact parameter (...) at which lines reach the water, mm.

    The impact parameter is that outside the canister.
    """
    around2 = optics.n_around**2 - p_z**2
    total = [optics.inner_radius_mm * np.sqrt((n**2 - p_z**2) / around2) for n in (optics.n_wall, optics.n_water)]
    return np.asarray(np.minimum(optics.outer_radius_mm, np.minimum(*total)) * (1.0 - 1e-9))


def clip_to_water(optics: Optics, approach: Approach, share: float = 1.0) -> Approach:
    """Limit the impact parameters of lines to a fraction of the largest one at which lines reach the water.

    Results computed from lines whose impact parameter was changed are not meaningful.
    """
    limit_mm = share * reach_mm(optics, approach.p_z)
    return replace(approach, b_mm=np.clip(approach.b_mm, -limit_mm, limit_mm))


def reaches_water(optics: Optics, approach: Approach, share: float = 1.0) -> NDArray[np.bool_]:
    """Return whether each line (...) reaches the water within a fraction of the water's apparent width."""
    return np.asarray(np.abs(approach.b_mm) < share * reach_mm(optics, approach.p_z))


def from_point(rho_mm: Array | float, z_cam_mm: Array | float, b_mm: Array, p_z: Array) -> Approach:
    """Return rays (...) through the air from a camera at (rho, 0, z_cam) up to the canister.

    Parameters
    ----------
    rho_mm, z_cam_mm : (...) array or float
        Position of the camera.
    b_mm, p_z : (...) array
        Impact parameter, mm, and vertical component of the rays.

    Returns
    -------
    Approach
        Lines of sight outside the canister.
    """
    climb = p_z / np.sqrt(1.0 - p_z**2)
    foot_z = z_cam_mm + climb * np.sqrt(rho_mm**2 - b_mm**2)
    return Approach(b_mm=b_mm, p_z=p_z, heading_rad=np.pi - np.arcsin(b_mm / rho_mm), foot_z_mm=foot_z)


@dataclass(frozen=True, kw_only=True)
class WaterLine(_HeadedLines):
    """Straight lines of sight in the water, in the camera's azimuth frame."""

    b_mm: Array
    """(...) signed distance from the axis, mm: P . nu = b for points P on the line."""
    heading_rad: Array
    """(...) azimuth of the horizontal direction t, rad."""
    slope: Array
    """(...) rise per horizontal distance, p_z / h_water."""
    entry_z_mm: Array
    """(...) height at which the line enters the water at the inner wall, mm."""
    outer_z_mm: Array
    """(...) height at which the ray meets the outer wall, mm."""


def follow(optics: Optics, approach: Approach) -> WaterLine:
    """Trace lines of sight through the canister's wall into the water; NaN for lines that do not reach it."""
    r_o, r_i, p_z, b_a = optics.outer_radius_mm, optics.inner_radius_mm, approach.p_z, approach.b_mm
    h_a = np.sqrt(optics.n_around**2 - p_z**2)
    h_g = np.sqrt(optics.n_wall**2 - p_z**2)
    h_w = np.sqrt(optics.n_water**2 - p_z**2)
    b_g = b_a * h_a / h_g
    b_w = b_a * h_a / h_w
    heading = approach.heading_rad + np.arcsin(b_a / r_o) - np.arcsin(b_g / r_o)
    heading = heading + np.arcsin(b_g / r_i) - np.arcsin(b_w / r_i)
    s_g = np.sqrt(r_o**2 - b_g**2) - np.sqrt(r_i**2 - b_g**2)
    outer_z = approach.foot_z_mm - p_z / h_a * np.sqrt(r_o**2 - b_a**2)
    return WaterLine(b_mm=b_w, heading_rad=heading, slope=p_z / h_w, entry_z_mm=outer_z + p_z / h_g * s_g, outer_z_mm=outer_z)


def enters(optics: Optics, line: WaterLine) -> NDArray[np.bool_]:
    """Return whether each line (...) enters the water through the wall."""
    with np.errstate(invalid="ignore"):
        inside = (line.entry_z_mm < optics.water_z_mm) & (line.entry_z_mm > optics.floor_z_mm) & (line.outer_z_mm > optics.bottom_z_mm)
        inside &= np.isfinite(line.heading_rad)
        return np.asarray(inside if optics.tank is None else inside & (line.outer_z_mm < optics.tank.level_mm))


def transmittance(optics: Optics, approach: Approach) -> Array:
    """Return the transmittance (...) of unpolarised light along rays into the water and out again.

    The result is the product of the transmittances of the four interfaces, which follow from Fresnel's equations. With
    ``a_i = n_i cos(theta_i) = sqrt(h_i^2 - (L / r)^2)`` at the radius r, the reflectances are ``R_s = ((a_1 - a_2) /
    (a_1 + a_2))^2`` and ``R_p = ((n_2^2 a_1 - n_1^2 a_2) / (n_2^2 a_1 + n_1^2 a_2))^2``.
    """
    p_z, around = approach.p_z, optics.n_around
    momentum = approach.b_mm * np.sqrt(around**2 - p_z**2)
    through = np.ones(np.broadcast(momentum, p_z).shape)
    for radius, n_1, n_2 in ((optics.outer_radius_mm, around, optics.n_wall), (optics.inner_radius_mm, optics.n_wall, optics.n_water)):
        a_1, a_2 = (np.sqrt(np.maximum(n**2 - p_z**2 - (momentum / radius) ** 2, 1e-12)) for n in (n_1, n_2))
        r_s = ((a_1 - a_2) / (a_1 + a_2)) ** 2
        r_p = ((n_2**2 * a_1 - n_1**2 * a_2) / (n_2**2 * a_1 + n_1**2 * a_2)) ** 2
        through = through * (1.0 - 0.5 * (r_s + r_p)) ** 2
    return through


def height_at(optics: Optics, line: WaterLine, points_xy_mm: Array) -> Array:
    """Return the height (...) of each line at a horizontal position (..., 2) in the azimuth frame, mm."""
    along = np.sum(points_xy_mm * line.t, axis=-1)
    return line.entry_z_mm + line.slope * (along + np.sqrt(optics.inner_radius_mm**2 - line.b_mm**2))


def miss_distances(optics: Optics, approach: Approach, points_mm: Array) -> Array:
    """Return the horizontal distances f1 and the vertical distances f2 (N, 2) by which lines miss points, mm.

    The distances are NaN if a line does not reach the water. The points (N, 3) are in the azimuth frame, mm.
    """
    with np.errstate(invalid="ignore"):
        line = follow(optics, approach)
        beside = np.sum(points_mm[:, :2] * line.nu, axis=-1) - line.b_mm
        return np.stack([beside, height_at(optics, line, points_mm[:, :2]) - points_mm[:, 2]], axis=-1)
