"""Lines of sight in a tank's liquid, computed from rays at its front, with derivatives (Dr.Jit, float32).

The mathematics and symbols are those of `recon.optics.tank`.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from rhizotwin.recon.device import Bool, Float, Point3f, Vector3f
from rhizotwin.scenes.model import Tank

Pair = tuple[Float, Float]
"""Two numbers that refer to q_y and q_z, such as derivatives."""


@dataclass(frozen=True)
class Place:
    """Relative poses of a view's camera, tank and canister, as kernel parameters."""

    centre: list[Float]
    """(3,) camera centre in the tank's frame, mm."""
    turn: list[Float]
    """(9,) rotation matrix from the tank's frame to the azimuth frame, row by row."""
    shift: list[Float]
    """(3,) translation from the tank's frame to the azimuth frame, mm."""

    def rotate(self, v: tuple[Float, Float, Float]) -> Vector3f:
        """Rotate a direction from the tank's frame to the azimuth frame."""
        r = self.turn
        return mi.Vector3f(*(r[3 * i] * v[0] + r[3 * i + 1] * v[1] + r[3 * i + 2] * v[2] for i in range(3)))

    def to_tank(self, p: Point3f) -> tuple[Float, Float, Float]:
        """Transform a point, mm, from the azimuth frame to the tank's frame."""
        x, y, z = (p[i] - self.shift[i] for i in range(3))
        r = self.turn
        return r[0] * x + r[3] * y + r[6] * z, r[1] * x + r[4] * y + r[7] * z, r[2] * x + r[5] * y + r[8] * z


@dataclass(frozen=True)
class Line:
    """Straight line in the liquid, in the azimuth frame, with derivatives.

    All fields are Dr.Jit arrays of type mi.Float, except ``through`` (mi.Bool).
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
    b_q: Pair
    """Derivatives of the impact parameter with respect to q_y and q_z, mm."""
    p_q: Pair
    """Derivatives of the vertical component with respect to q_y and q_z."""
    h_q: Pair
    """Derivatives of the heading with respect to q_y and q_z, rad."""
    z_q: Pair
    """Derivatives of ``foot_z`` with respect to q_y and q_z, mm."""
    through: Bool
    """Whether the ray passes through the front below the liquid's surface."""


def straight(tank: Tank, at: Place, point: Point3f) -> Pair:
    """Return initial values (q_y, q_z) of the rays to points in the azimuth frame.

    The values are those of straight rays to points at the same apparent depth behind the front.
    """
    x, y, z = at.to_tank(point)
    c = at.centre
    depth = c[0] - tank.front_mm + tank.wall_mm / tank.n_wall + (tank.front_mm - tank.wall_mm - x) / tank.n_liquid
    per = dr.rsqrt(dr.square(depth) + dr.square(y - c[1]) + dr.square(z - c[2]))
    return (y - c[1]) * per, (z - c[2]) * per


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
    n, q = tank.n_liquid, (q_y, q_z)
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
    s = at.rotate((mi.Float(tank.front_mm - tank.wall_mm), inside_y, inside_z)) + mi.Vector3f(*at.shift)
    p = at.rotate((-a, q_y, q_z))
    h2 = n**2 - p.z * p.z
    ih = dr.rsqrt(h2)
    ih2 = ih * ih
    b, along = (s.x * p.y - s.y * p.x) * ih, s.x * p.x + s.y * p.y
    derived: list[list[Float]] = [[], [], [], []]
    for j in (0, 1):
        here, other = (1.0, 0.0) if j == 0 else (0.0, 1.0)
        s_j = at.rotate((mi.Float(0.0), aside * here + aside_q2 * q_y * q[j], aside * other + aside_q2 * q_z * q[j]))
        p_j = at.rotate((q[j] / a, mi.Float(here), mi.Float(other)))
        momentum_j = s_j.x * p.y + s.x * p_j.y - s_j.y * p.x - s.y * p_j.x
        along_j = s_j.x * p.x + s.x * p_j.x + s_j.y * p.y + s.y * p_j.y
        derived[0].append((momentum_j + b * p.z * p_j.z * ih) * ih)
        derived[1].append(p_j.z)
        derived[2].append((p.x * p_j.y - p.y * p_j.x) * ih2)
        derived[3].append(s_j.z - (p_j.z * along + p.z * along_j + 2 * p.z * p.z * along * p_j.z * ih2) * ih2)
    b_q, p_q, h_q, z_q = ((one[0], one[1]) for one in derived)
    return Line(b, p.z, -p.x * ih, -p.y * ih, s.z - p.z * along * ih2, b_q, p_q, h_q, z_q, through)
