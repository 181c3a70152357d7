"""Ray tracing in kernels: through the wall and the water to a point, and through the lens to a pixel (Dr.Jit, float32).

The mathematics and symbols are those of `recon.optics.refraction` and, for lines in a tank's liquid, of
`recon.optics.tank`. A ray is defined by its impact parameter b and its vertical component p outside the outer wall. All
functions also return the derivatives with respect to b and p, with which `optics.projection` solves for the ray through
a point.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi

from rhizotwin.recon.device import Bool, Float
from rhizotwin.recon.optics import window
from rhizotwin.recon.optics.refraction import Optics


@dataclass
class Near:
    """Rays from the camera up to the outer wall, with derivatives with respect to b and p.

    For lines in a tank, the heading and the height of the point nearest to the axis are constant in these derivatives.
    """

    turn: tuple[Float, Float]
    """Real and imaginary part of a complex number. Its argument is the heading of the ray outside the canister, minus
    pi, plus asin(b / R_o), where R_o is the outer radius. Its modulus is a product of radii."""
    per_radii: Float
    """Factor by which complex numbers that represent headings are normalised. It is the inverse of the product of all
    radii, including those of the wall and the water."""
    turn_b: Float
    """Derivative of the argument of ``turn`` with respect to b, rad/mm."""
    outer_z: Float
    """Height at which the ray meets the outer wall, mm."""
    z_b: Float
    """Derivative of ``outer_z`` with respect to b."""
    z_p: Float
    """Derivative of ``outer_z`` with respect to p, mm."""


@dataclass
class Ray:
    """Rays in the water, and the distances by which they miss points.

    All fields are mi.Float. The symbols are those of `optics.refraction`.
    """

    f1: Float
    """Horizontal distance of the point from the ray, mm."""
    f2: Float
    """Vertical distance of the ray from the point, mm."""
    f1_b: Float
    """Derivative of f1 with respect to the impact parameter b."""
    f1_p: Float
    """Derivative of f1 with respect to the vertical component p, mm."""
    f2_b: Float
    """Derivative of f2 with respect to the impact parameter b."""
    f2_p: Float
    """Derivative of f2 with respect to the vertical component p, mm."""
    inv: Float
    """Inverse of the determinant of the derivatives of f1 and f2 with respect to b and p."""
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


def from_camera(o: Optics, view: tuple[Float, Float, Float], b: Float, p: Float) -> Near:
    """Trace rays through the air from a camera to the outer wall.

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
    return Near((c_o * c_r + b * b, b * (c_r - c_o)), per_radii, ic_o - ic_r, z_cam + m_a * s_a, m_a * s_a_b, s_a * ih_a2 * ih_a)


def from_line(o: Optics, line: window.Line, b: Float) -> Near:
    """Trace lines in a tank's liquid up to the outer wall, which they meet with the impact parameter b."""
    ih = dr.rsqrt(o.n_around**2 - line.p * line.p)
    c_o2 = o.outer_radius_mm**2 - b * b
    ic_o = dr.rsqrt(c_o2)
    c_o, climb = c_o2 * ic_o, line.p * ih
    turn = line.cos_h * c_o - line.sin_h * b, line.sin_h * c_o + line.cos_h * b
    z_b, z_p = climb * b * ic_o, -(o.n_around**2) * c_o * ih * ih * ih
    return Near(turn, mi.Float(1 / (o.outer_radius_mm * o.inner_radius_mm) ** 2), ic_o, line.foot_z - climb * c_o, z_b, z_p)


def to_tank_derivatives(ray: Ray, line: window.Line, at: tuple[Float, Float, Float]) -> Ray:
    """Convert the derivatives of rays with respect to (b, p) to derivatives with respect to (q_y, q_z)."""
    along, beside = -at[0] * ray.cos_d - at[1] * ray.sin_d, -at[0] * ray.sin_d + at[1] * ray.cos_d
    f1 = [ray.f1_b * line.b_q[j] + ray.f1_p * line.p_q[j] + along * line.h_q[j] for j in (0, 1)]
    f2 = [ray.f2_b * line.b_q[j] + ray.f2_p * line.p_q[j] - ray.m_w * beside * line.h_q[j] + line.z_q[j] for j in (0, 1)]
    return replace(ray, f1_b=f1[0], f1_p=f1[1], f2_b=f2[0], f2_p=f2[1], inv=1 / (f1[0] * f2[1] - f1[1] * f2[0]))


def follow(o: Optics, n_w: Float, near: Near, at: tuple[Float, Float, Float], b: Float, p: Float) -> Ray:
    """Trace rays through the wall and the water to points in the azimuth frame.

    Parameters
    ----------
    o, n_w : Optics, Float
        Optics of the canister, and refractive index of the water, which may differ between the lanes of the kernel.
    near : Near
        Rays up to the outer wall.
    at : (3,) mi.Float
        Points, mm.
    b, p : Float
        Impact parameter outside the canister, mm, and vertical component p_z of the rays.

    Returns
    -------
    Ray
        Rays in the water, and their distances from the points, with derivatives with respect to b and p.
    """
    x, y, z = at
    r_o, r_i = o.outer_radius_mm, o.inner_radius_mm
    p2 = p * p
    h_a2, h_g2, h_w2 = o.n_around**2 - p2, o.n_wall**2 - p2, n_w**2 - p2
    ih_a, ih_g, ih_w = dr.rsqrt(h_a2), dr.rsqrt(h_g2), dr.rsqrt(h_w2)
    ih_a2, ih_g2, ih_w2 = ih_a * ih_a, ih_g * ih_g, ih_w * ih_w
    h_a = h_a2 * ih_a
    k_g, k_w = h_a * ih_g, h_a * ih_w  # db_g/db_a, db_w/db_a
    b_g, b_w = b * k_g, b * k_w
    b_g_p, b_w_p = b_g * p * (ih_g2 - ih_a2), b_w * p * (ih_w2 - ih_a2)
    # Distance c along the line from its nearest point to the axis to the crossing with each radius, and 1 / c.
    c_og2, c_ig2, c_w2 = r_o**2 - b_g * b_g, r_i**2 - b_g * b_g, r_i**2 - b_w * b_w
    ic_og, ic_ig, ic_w = (dr.rsqrt(square) for square in (c_og2, c_ig2, c_w2))
    c_og, c_ig, c_w = c_og2 * ic_og, c_ig2 * ic_ig, c_w2 * ic_w
    # delta = heading - pi: the sum of +-asin(b / r) at each radius, as a product of unit complex numbers (c +- i b) / r
    air, wall = near.turn, (c_ig * c_og + b_g * b_g, b_g * (c_og - c_ig))
    turn = air[0] * wall[0] - air[1] * wall[1], air[0] * wall[1] + air[1] * wall[0]
    cos_d, sin_d = (turn[0] * c_w + turn[1] * b_w) * near.per_radii, (turn[1] * c_w - turn[0] * b_w) * near.per_radii
    delta_b = near.turn_b + k_g * (ic_ig - ic_og) - k_w * ic_w
    delta_p = b_g_p * (ic_ig - ic_og) - b_w_p * ic_w
    along, beside = -x * cos_d - y * sin_d, -x * sin_d + y * cos_d  # P . t, P . nu
    # f and its Jacobian with respect to (b, p)
    m_g, m_w = p * ih_g, p * ih_w  # slopes
    s_g, s_w = c_og - c_ig, along + c_w
    f1_b, f1_p = along * delta_b - k_w, along * delta_p - b_w_p
    s_g_bg, s_w_bw = b_g * (ic_ig - ic_og), b_w * ic_w
    f2_b = near.z_b + m_g * s_g_bg * k_g - m_w * (beside * delta_b + s_w_bw * k_w)
    f2_p = near.z_p + o.n_wall**2 * s_g * ih_g * ih_g2 + n_w**2 * s_w * ih_w * ih_w2
    f2_p += m_g * s_g_bg * b_g_p - m_w * (beside * delta_p + s_w_bw * b_w_p)
    f2 = near.outer_z + m_g * s_g + m_w * s_w - z
    inv = 1 / (f1_b * f2_p - f1_p * f2_b)
    return Ray(beside - b_w, f2, f1_b, f1_p, f2_b, f2_p, inv, cos_d, sin_d, m_w, h_a, h_a2, near.outer_z, near.outer_z + m_g * s_g)


Pixel = tuple[Float, Float, Bool, tuple[Float, Float, Float, Float]]
"""Result of the projection of rays. The elements are, in this order, the column and the row of the ray in pixels,
whether the ray is in front of the camera and the lens distortion is valid there (`scenes.lens.fold_r2`), and the
derivatives of column and row with respect to two unknowns."""


def direct_pixel(parameter: list[Float], b: Float, p: Float, ray: Ray) -> Pixel:
    """Return the pixels of rays from cameras without a tank, and their derivatives with respect to (b, p).

    Parameters
    ----------
    parameter : list of mi.Float
        Kernel parameters of a view, as packed by `projection.ViewBank`.
    """
    rho, h_a = parameter[9], ray.h_a
    # direction in air, and its derivatives with respect to (b, p)
    d_y = b * h_a / rho
    q = dr.sqrt(ray.h_a2 - d_y * d_y)
    d_y_b, d_y_p = h_a / rho, -b * p / (h_a * rho)
    d_x_b, d_x_p = d_y * d_y_b / q, (p + d_y * d_y_p) / q
    return through_lens(parameter, (-q, d_y, p), (d_x_b, d_y_b, mi.Float(0.0)), (d_x_p, d_y_p, mi.Float(1.0)))


def through_lens(parameter: list[Float], direction: tuple[Float, ...], by_1: tuple[Float, ...], by_2: tuple[Float, ...]) -> Pixel:
    """Project directions to pixels, using the rotation and the lens of a camera.

    The derivatives of the pixels with respect to two unknowns are also computed.

    Parameters
    ----------
    parameter : list of mi.Float
        Kernel parameters of a view, as packed by `projection.ViewBank`.
    direction : (3,) mi.Float
        Direction before the rotation of the camera, of any length.
    by_1, by_2 : (3,) mi.Float
        Derivatives of the direction with respect to the two unknowns.

    Returns
    -------
    Pixel
        Pixels, with derivatives with respect to the two unknowns.
    """
    r = parameter[:9]
    (cx, cy, cz), (cx_b, cy_b, cz_b), (cx_p, cy_p, cz_p) = (
        [r[3 * i] * d[0] + r[3 * i + 1] * d[1] + r[3 * i + 2] * d[2] for i in range(3)] for d in (direction, by_1, by_2)
    )
    iz = 1 / cz
    xn, yn = cx * iz, cy * iz
    xn_b, yn_b = (cx_b - xn * cz_b) * iz, (cy_b - yn * cz_b) * iz
    xn_p, yn_p = (cx_p - xn * cz_p) * iz, (cy_p - yn * cz_p) * iz
    (u, v), (u_x, u_y, v_y), valid = distort(parameter, xn, yn)
    fx, fy, px0, py0 = parameter[13:17]
    u_b, u_p = fx * (u_x * xn_b + u_y * yn_b), fx * (u_x * xn_p + u_y * yn_p)
    v_b, v_p = fy * (u_y * xn_b + v_y * yn_b), fy * (u_y * xn_p + v_y * yn_p)
    return fx * u + px0, fy * v + py0, (cz > 0) & valid, (u_b, u_p, v_b, v_p)


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
