"""Ray tracing in kernels: through the wall and the water to a point, and through the lens to a pixel (Dr.Jit, float32).

The mathematics and symbols are those of `recon.optics.refraction` and, for lines in a tank's liquid, of
`recon.optics.tank`. A ray is defined by its impact parameter b and its vertical component p outside the outer wall. All
functions also return gradients with respect to two unknowns, with which `optics.projection` solves for the ray through
a point. The unknowns are b and p or, through a tank, q_y and q_z.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from rhizotwin.recon.device import Bool, Float, Vector2f
from rhizotwin.recon.optics import window
from rhizotwin.recon.optics.refraction import Optics

NEAR_MM = 3e-4
"""Distance of a ray from a point above which the point is invisible, mm. It is a thousandth of a bench's pixel (0.23
mm), and ten times the spacing of single-precision numbers at the camera's distance (3e-5 mm from 256 to 512 mm)."""


@dataclass
class Near:
    """Rays from the camera up to the outer wall, with gradients (mi.Vector2f) with respect to the two unknowns."""

    b: Float
    """Impact parameter, mm."""
    p: Float
    """Vertical component p_z of the optical direction."""
    b_q: Vector2f
    """Gradient of the impact parameter."""
    p_q: Vector2f
    """Gradient of the vertical component."""
    turn: tuple[Float, Float]
    """Real and imaginary part of a complex number. Its argument is the heading of the ray outside the canister, minus
    pi, plus asin(b / R_o), where R_o is the outer radius. Its modulus is a product of radii."""
    per_radii: Float
    """Factor by which complex numbers that represent headings are normalised. It is the inverse of the product of all
    radii, including those of the wall and the water."""
    turn_q: Vector2f
    """Gradient of the argument of ``turn``, rad."""
    outer_z: Float
    """Height at which the ray meets the outer wall, mm."""
    z_q: Vector2f
    """Gradient of ``outer_z``, mm."""


@dataclass
class Ray:
    """Rays in the water, and the distances by which they miss points.

    The symbols are those of `optics.refraction`. Gradients (mi.Vector2f) are with respect to the two unknowns, and all
    other fields are mi.Float.
    """

    f1: Float
    """Horizontal distance of the point from the ray, mm."""
    f2: Float
    """Vertical distance of the ray from the point, mm."""
    f1_q: Vector2f
    """Gradient of f1."""
    f2_q: Vector2f
    """Gradient of f2."""
    cos_d: Float
    """Cosine of d, which is the heading in the water minus pi."""
    sin_d: Float
    """Sine of d, which is the heading in the water minus pi."""
    m_w: Float
    """Slope of the ray in the water: rise per horizontal distance."""
    h_a: Float
    """Horizontal component of the optical direction outside the canister."""
    h_a2: Float
    """Square of ``h_a``."""
    outer_z: Float
    """Height at which the ray enters the wall, mm."""
    entry_z: Float
    """Height at which the ray enters the water, mm."""

    def solve(self, f1: Float, f2: Float) -> Vector2f:
        """Return the changes of the two unknowns that increase the distances by f1 and f2, to first order."""
        inv = 1 / (self.f1_q.x * self.f2_q.y - self.f1_q.y * self.f2_q.x)
        return mi.Vector2f(inv * (self.f2_q.y * f1 - self.f1_q.y * f2), inv * (self.f1_q.x * f2 - self.f2_q.x * f1))

    def arrives(self, o: Optics) -> Bool:
        """Return whether the ray enters the water through the wall, and reaches the point within `NEAR_MM`."""
        enters = (self.entry_z < o.water_z_mm) & (self.entry_z > o.floor_z_mm) & (self.outer_z > o.bottom_z_mm)
        return (dr.abs(self.f1) < NEAR_MM) & (dr.abs(self.f2) < NEAR_MM) & enters


def from_camera(o: Optics, view: tuple[Float, Float, Float], b: Float, p: Float) -> Near:
    """Trace rays through the air from a camera to the outer wall. The unknowns are b and p.

    Parameters
    ----------
    view : tuple of mi.Float
        Horizontal distance of the camera from the axis, mm, its height, mm, and the inverse of the product of the
        radii.
    """
    rho, z_cam, per_radii = view
    p2 = p * p
    ih_a = dr.rsqrt(1 - p2)
    ih_a2 = ih_a * ih_a
    c_r2, c_o2 = rho * rho - b * b, o.outer_radius_mm**2 - b * b
    ic_r, ic_o = dr.rsqrt(c_r2), dr.rsqrt(c_o2)
    c_r, c_o = c_r2 * ic_r, c_o2 * ic_o
    m_a, s_a = p * ih_a, c_r - c_o
    s_a_b = b * (ic_o - ic_r)
    return Near(
        b=b,
        p=p,
        b_q=mi.Vector2f(1, 0),
        p_q=mi.Vector2f(0, 1),
        turn=(c_o * c_r + b * b, b * (c_r - c_o)),
        per_radii=per_radii,
        turn_q=mi.Vector2f(ic_o - ic_r, 0),
        outer_z=z_cam + m_a * s_a,
        z_q=mi.Vector2f(m_a * s_a_b, s_a * ih_a2 * ih_a),
    )


def from_line(o: Optics, line: window.Line, b: Float) -> Near:
    """Trace lines in a tank's liquid up to the outer wall, which they meet with the impact parameter b.

    The unknowns are q_y and q_z.
    """
    ih = dr.rsqrt(o.n_around**2 - line.p * line.p)
    c_o2 = o.outer_radius_mm**2 - b * b
    ic_o = dr.rsqrt(c_o2)
    c_o, climb = c_o2 * ic_o, line.p * ih
    return Near(
        b=b,
        p=line.p,
        b_q=line.b_q,
        p_q=line.p_q,
        turn=(line.cos_h * c_o - line.sin_h * b, line.sin_h * c_o + line.cos_h * b),
        per_radii=mi.Float(1 / (o.outer_radius_mm * o.inner_radius_mm) ** 2),
        turn_q=line.h_q + ic_o * line.b_q,
        outer_z=line.foot_z - climb * c_o,
        z_q=line.z_q + climb * b * ic_o * line.b_q - o.n_around**2 * c_o * ih * ih * ih * line.p_q,
    )


def follow(o: Optics, n_w: Float, near: Near, at: tuple[Float, Float, Float]) -> Ray:
    """Trace rays through the wall and the water to points in the azimuth frame.

    Parameters
    ----------
    o, n_w : Optics, Float
        Optics of the canister, and refractive index of the water, which may differ between the lanes of the kernel.
    near : Near
        Rays up to the outer wall.
    at : (3,) mi.Float
        Points, mm.

    Returns
    -------
    Ray
        Rays in the water, and their distances from the points, with gradients.
    """
    (x, y, z), b, p = at, near.b, near.p
    r_o, r_i = o.outer_radius_mm, o.inner_radius_mm
    p2 = p * p
    h_a2, h_g2, h_w2 = o.n_around**2 - p2, o.n_wall**2 - p2, n_w**2 - p2
    ih_a, ih_g, ih_w = dr.rsqrt(h_a2), dr.rsqrt(h_g2), dr.rsqrt(h_w2)
    ih_a2, ih_g2, ih_w2 = ih_a * ih_a, ih_g * ih_g, ih_w * ih_w
    h_a = h_a2 * ih_a
    k_g, k_w = h_a * ih_g, h_a * ih_w  # db_g/db_a, db_w/db_a
    b_g, b_w = b * k_g, b * k_w
    b_g_q = k_g * near.b_q + b_g * p * (ih_g2 - ih_a2) * near.p_q
    b_w_q = k_w * near.b_q + b_w * p * (ih_w2 - ih_a2) * near.p_q
    # Distance c along the line from its nearest point to the axis to the crossing with each radius, and 1 / c.
    c_og2, c_ig2, c_w2 = r_o**2 - b_g * b_g, r_i**2 - b_g * b_g, r_i**2 - b_w * b_w
    ic_og, ic_ig, ic_w = (dr.rsqrt(square) for square in (c_og2, c_ig2, c_w2))
    c_og, c_ig, c_w = c_og2 * ic_og, c_ig2 * ic_ig, c_w2 * ic_w
    # delta = heading - pi: the sum of +-asin(b / r) at each radius, as a product of unit complex numbers (c +- i b) / r
    air, wall = near.turn, (c_ig * c_og + b_g * b_g, b_g * (c_og - c_ig))
    turn = air[0] * wall[0] - air[1] * wall[1], air[0] * wall[1] + air[1] * wall[0]
    cos_d, sin_d = (turn[0] * c_w + turn[1] * b_w) * near.per_radii, (turn[1] * c_w - turn[0] * b_w) * near.per_radii
    delta_q = near.turn_q + (ic_ig - ic_og) * b_g_q - ic_w * b_w_q
    along, beside = -x * cos_d - y * sin_d, -x * sin_d + y * cos_d  # P . t, P . nu
    m_g, m_w = p * ih_g, p * ih_w  # slopes
    s_g, s_w = c_og - c_ig, along + c_w
    f2_q = near.z_q + o.n_wall**2 * s_g * ih_g * ih_g2 * near.p_q + n_w**2 * s_w * ih_w * ih_w2 * near.p_q
    f2_q += m_g * (b_g * (ic_ig - ic_og)) * b_g_q - m_w * (beside * delta_q + b_w * ic_w * b_w_q)
    entry_z = near.outer_z + m_g * s_g
    f1_q = along * delta_q - b_w_q
    return Ray(beside - b_w, entry_z + m_w * s_w - z, f1_q, f2_q, cos_d, sin_d, m_w, h_a, h_a2, near.outer_z, entry_z)


Pixel = tuple[Float, Float, Bool, Any, Any]
"""Result of the projection of rays. The elements are, in this order, the column and the row of the ray in pixels,
whether the ray is in front of the camera and the lens distortion is valid there (`scenes.lens.fold_r2`), and the
gradients of column and row."""


def direct_pixel(parameter: list[Float], near: Near, ray: Ray) -> Pixel:
    """Return the pixels of rays from cameras without a tank, and their gradients with respect to (b, p).

    Parameters
    ----------
    parameter : list of mi.Float
        Kernel parameters of a view, as packed by `projection.ViewBank`.
    """
    rho, h_a, b, p = parameter[9], ray.h_a, near.b, near.p
    # direction in air, and its gradient
    d_y = b * h_a / rho
    q = dr.sqrt(ray.h_a2 - d_y * d_y)
    d_y_q = mi.Vector2f(h_a / rho, -b * p / (h_a * rho))
    return through_lens(parameter, (-q, d_y, p), ((p * near.p_q + d_y * d_y_q) / q, d_y_q, near.p_q))


def through_lens(parameter: list[Float], direction: tuple[Float, ...], by: tuple[Any, Any, Any]) -> Pixel:
    """Project directions to pixels, using the rotation and the lens of a camera.

    Parameters
    ----------
    parameter : list of mi.Float
        Kernel parameters of a view, as packed by `projection.ViewBank`.
    direction : (3,) mi.Float
        Direction before the rotation of the camera, of any length.
    by : (3,) mi.Vector2f or mi.Vector3f
        Gradients of the direction with respect to any number of unknowns.

    Returns
    -------
    Pixel
        Pixels, with gradients with respect to the same unknowns.
    """
    (x, y, z), (x_q, y_q, z_q) = (window.rotate(parameter, part) for part in (direction, by))
    iz = 1 / z
    xn, yn = x * iz, y * iz
    xn_q, yn_q = (x_q - xn * z_q) * iz, (y_q - yn * z_q) * iz
    (u, v), (u_x, u_y, v_y), valid = distort(parameter, xn, yn)
    fx, fy, px0, py0 = parameter[13:17]
    return fx * u + px0, fy * v + py0, (z > 0) & valid, fx * (u_x * xn_q + u_y * yn_q), fy * (u_y * xn_q + v_y * yn_q)


def distort(parameter: list[Float], xn: Float, yn: Float) -> tuple[tuple[Float, Float], tuple[Float, Float, Float], Bool]:
    """Apply the lens distortion to normalised coordinates.

    Parameters
    ----------
    parameter : list of mi.Float
        Kernel parameters of a view, as packed by `projection.ViewBank`.
    xn, yn : mi.Float
        Undistorted coordinates in the plane at depth 1 in front of the camera.

    Returns
    -------
    (u, v) : tuple of mi.Float
        Distorted coordinates.
    (u_x, u_y, v_y) : tuple of mi.Float
        Derivatives du/dx, du/dy = dv/dx, and dv/dy.
    valid : mi.Bool
        Whether the distortion is valid at these coordinates (`scenes.lens.fold_r2`).
    """
    k1, k2, p1, p2, k3 = parameter[17:22]
    r2 = xn * xn + yn * yn
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    radial_r2 = k1 + r2 * (2 * k2 + 3 * r2 * k3)
    u = xn * radial + 2 * p1 * xn * yn + p2 * (r2 + 2 * xn * xn)
    v = yn * radial + p1 * (r2 + 2 * yn * yn) + 2 * p2 * xn * yn
    u_x = radial + 2 * xn * xn * radial_r2 + 2 * p1 * yn + 6 * p2 * xn
    u_y = 2 * xn * yn * radial_r2 + 2 * p1 * xn + 2 * p2 * yn
    v_y = radial + 2 * yn * yn * radial_r2 + 6 * p1 * yn + 2 * p2 * xn
    return (u, v), (u_x, u_y, v_y), r2 < parameter[23]
