"""Lines of sight in a tank's liquid, computed from rays at its front, with derivatives (Dr.Jit, float32).

The mathematics and symbols are those of `recon.optics.tank`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from rhizotwin.recon.device import Bool, Float, Point3f, Vector2f
from rhizotwin.scenes.model import Tank


def rotate(matrix: list[Float], v: tuple[Any, Any, Any]) -> list[Any]:
    """Multiply a matrix (9,), given row by row, with three numbers or three gradients."""
    return [matrix[3 * i] * v[0] + matrix[3 * i + 1] * v[1] + matrix[3 * i + 2] * v[2] for i in range(3)]


@dataclass(frozen=True)
class Place:
    """Relative poses of a view's camera, tank and canister, as kernel parameters."""

    centre: list[Float]
    """(3,) camera centre in the tank's frame, mm."""
    turn: list[Float]
    """(9,) rotation matrix from the tank's frame to the azimuth frame, row by row."""
    shift: list[Float]
    """(3,) translation from the tank's frame to the azimuth frame, mm."""

    def to_tank(self, p: Point3f) -> list[Float]:
        """Transform a point, mm, from the azimuth frame to the tank's frame."""
        x, y, z = (p[i] - self.shift[i] for i in range(3))
        return rotate([self.turn[k] for k in (0, 3, 6, 1, 4, 7, 2, 5, 8)], (x, y, z))


@dataclass(frozen=True)
class Line:
    """Straight line in the liquid, in the azimuth frame, with derivatives.

    All fields are Dr.Jit arrays: gradients are mi.Vector2f, ``through`` is mi.Bool, and the others are mi.Float.
    """

    b: Float
    """Impact parameter, mm."""
    p: Float
    """Vertical component p_z of the optical direction."""
    cos_h: Float
    """Cosine of h, which is the heading minus pi."""
    sin_h: Float
    """Sine of h, which is the heading minus pi."""
    foot_z: Float
    """Height of the point nearest to the canister's axis, mm."""
    b_q: Vector2f
    """Gradient of the impact parameter with respect to q_y and q_z, mm."""
    p_q: Vector2f
    """Gradient of the vertical component with respect to q_y and q_z."""
    h_q: Vector2f
    """Gradient of the heading with respect to q_y and q_z, rad."""
    z_q: Vector2f
    """Gradient of ``foot_z`` with respect to q_y and q_z, mm."""
    through: Bool
    """Whether the ray passes through the front below the liquid's surface."""


def straight(tank: Tank, at: Place, point: Point3f) -> Float:
    """Return the component q_z of straight rays to points in the azimuth frame, at their depth behind the front."""
    x, y, z = at.to_tank(point)
    c = at.centre
    depth = c[0] - tank.front_mm + tank.wall_mm / tank.n_wall + (tank.front_mm - tank.wall_mm - x) / tank.n_liquid
    return (z - c[2]) * dr.rsqrt(dr.square(depth) + dr.square(y - c[1]) + dr.square(z - c[2]))


def line(tank: Tank, at: Place, q_y: Float, q_z: Float, *, bottom_z_mm: float) -> Line:
    """Trace rays through the front of a tank into the liquid.

    Parameters
    ----------
    tank, at : Tank, Place
        Tank, and its pose relative to the camera and the canister.
    q_y, q_z : Float
        Components of the rays' unit directions in air along the front, tank's frame.
    bottom_z_mm : float
        Height of the canister's underside, mm.

    Returns
    -------
    Line
        Lines in the tank's liquid, with derivatives with respect to q_y and q_z.
    """
    n, q = tank.n_liquid, mi.Vector2f(q_y, q_z)
    q2 = q_y * q_y + q_z * q_z
    ia_air, ia_wall = dr.rsqrt(1 - q2), dr.rsqrt(tank.n_wall**2 - q2)
    a = dr.sqrt(n**2 - q2)
    ahead = at.centre[0] - tank.front_mm
    aside = ahead * ia_air + tank.wall_mm * ia_wall
    aside_q2 = ahead * ia_air * ia_air * ia_air + tank.wall_mm * ia_wall * ia_wall * ia_wall  # d aside / dq = this q
    inside_y, inside_z = at.centre[1] + aside * q_y, at.centre[2] + aside * q_z
    front_z = at.centre[2] + ahead * ia_air * q_z
    through = dr.abs(inside_y) < tank.half_width_mm - tank.wall_mm
    for height in (front_z, inside_z):
        through &= (height < tank.level_mm) & (height > bottom_z_mm)
    inside = rotate(at.turn, (mi.Float(tank.front_mm - tank.wall_mm), inside_y, inside_z))
    s_x, s_y, s_z = (part + shift for part, shift in zip(inside, at.shift, strict=True))
    p_x, p_y, p_z = rotate(at.turn, (-a, q_y, q_z))
    by_y, by_z = mi.Vector2f(1, 0), mi.Vector2f(0, 1)
    s_xq, s_yq, s_zq = rotate(at.turn, (0, aside * by_y + aside_q2 * q_y * q, aside * by_z + aside_q2 * q_z * q))
    p_xq, p_yq, p_zq = rotate(at.turn, (q / a, by_y, by_z))
    h2 = n**2 - p_z * p_z
    ih = dr.rsqrt(h2)
    ih2 = ih * ih
    b, along = (s_x * p_y - s_y * p_x) * ih, s_x * p_x + s_y * p_y
    b_q = (s_xq * p_y + s_x * p_yq - s_yq * p_x - s_y * p_xq + b * p_z * ih * p_zq) * ih
    along_q = s_xq * p_x + s_x * p_xq + s_yq * p_y + s_y * p_yq
    h_q = (p_x * p_yq - p_y * p_xq) * ih2
    z_q = s_zq - (p_zq * along + p_z * along_q + 2 * p_z * p_z * along * ih2 * p_zq) * ih2
    return Line(b, p_z, -p_x * ih, -p_y * ih, s_z - p_z * along * ih2, b_q, p_zq, h_q, z_q, through)
