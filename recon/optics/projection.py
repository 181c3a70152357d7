"""Projection of water points through the canister into many views: the fast kernel (Dr.Jit, float32).

The mathematics and its symbols are those of `recon.optics.refraction`; here the two equations of a projection,

    f1 = P . nu - b_w = 0                                               the point lies beside the line
    f2 = z_entry + p_z / h_w (P . t + sqrt(R_i^2 - b_w^2)) - P_z = 0    and at its height

are solved for (b_a, p_z) by Newton's method with the analytic Jacobian, started from a small table per view. Points
that a view sees not at all, or twice (the water is a lens), are treated alike: such a view says nothing about them.
Through a tank's front the unknowns are the components (q_y, q_z) of the ray along it (`recon.optics.tank`), of which
`optics.window` makes the line in the liquid; from the canister's wall on the way is the same.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import drjit as dr
import mitsuba as mi
import numpy as np

from rhizotwin.recon.device import Bool, Float, Point3f, UInt32, Vector2f, Vector3f, bilinear, numbers
from rhizotwin.recon.optics import window
from rhizotwin.recon.optics.cameras import View, known_tank, through_tank
from rhizotwin.recon.optics.refraction import Array, Optics
from rhizotwin.recon.optics.start_tables import CELL_MM, view_table
from rhizotwin.recon.optics.window import Place
from rhizotwin.scenes import frames

_PARAMETERS = 40
"""Numbers a view, a multiple of four."""
_IN_OPEN = 24
"""So many of them are needed without a tank."""
NEWTON_STEPS, TANK_STEPS, NEAR_MM = 3, 4, 3e-4
"""In the open, and through a tank, whose rays have no symmetry to start from. What these steps do not bring this near
to its point counts as unseen: a thousandth of a bench's pixel (0.23 mm), and ten times the spacing of single precision
at the camera's distance (3e-5 mm from 256 to 512 mm)."""
_FLANK, _STEEPEST = 0.9995, 0.98
"""Steps stay within these shares of the largest impact parameter and climb: at one, slopes are infinite."""
_TABLE_MM = 0.2, 2.0
"""Cameras whose distances from the axis and heights differ by less share a start table, and so do tanks that stand to
them alike (turned by less than moves what is at the wall so far): Newton's steps make up for it."""


@dataclass(frozen=True)
class ViewBank:
    """The views of a dataset packed for the kernel."""

    optics: Optics
    count: int
    parameters: Float
    """mi.Float, `_PARAMETERS` numbers a view."""
    tables: Float
    """mi.Float, the start tables one after the other, (V, ny, nx, 2)."""
    table_shape: tuple[int, int]
    end: UInt32 = field(init=False, repr=False)
    """mi.UInt32, the count as an input of kernels: as a constant, it would make them new for every number of views."""

    def __post_init__(self) -> None:
        """Put the count on the device."""
        object.__setattr__(self, "end", dr.opaque(mi.UInt32, self.count))

    @staticmethod
    def of(views: Sequence[View], optics: Optics) -> ViewBank:
        """Pack views.

        Cameras at the same distance and height, within `_TABLE_MM`, share a start table's contents.
        """
        packed = np.zeros((len(views), _PARAMETERS))
        made: dict[tuple[int, ...], Array] = {}
        tables = []
        for k, view in enumerate(views):
            cam_from_azimuth = view.cam_from_canister @ frames.invert(view.azimuth_from_canister)
            turn = view.azimuth_from_canister
            packed[k, :9] = cam_from_azimuth[:3, :3].ravel()
            packed[k, 9:13] = view.rho_mm, view.centre_mm[2], turn[0, 0], turn[1, 0]
            packed[k, 13:15], packed[k, 15:17] = view.camera.focal_px, view.camera.principal_px
            packed[k, 17:22] = view.camera.distortion
            packed[k, 22] = optics.n_water  # no constant of the kernel: it may change
            key: tuple[int, ...] = (round(view.rho_mm / _TABLE_MM[0]), round(float(view.centre_mm[2]) / _TABLE_MM[1]))
            if optics.tank is not None:
                key += _pack_tank(packed[k], view, optics)
            if key not in made:
                made[key] = view_table(view, optics)
            tables.append(made[key])
        shape = tables[0].shape[:2]
        return ViewBank(optics, len(views), numbers(packed), numbers(np.stack(tables)), (shape[0], shape[1]))

    def chosen(self, which: Sequence[int]) -> ViewBank:
        """Return some of the views."""
        parts = (np.array(part).reshape(self.count, -1)[list(which)] for part in (self.parameters, self.tables))
        parameters, tables = (numbers(part) for part in parts)
        return ViewBank(self.optics, len(which), parameters, tables, self.table_shape)


def _pack_tank(packed: Array, view: View, optics: Optics) -> tuple[int, ...]:
    """Write how the tank stands into a view's numbers, and return what tells its start table from others."""
    at = through_tank(view, optics)
    turn, shift = at.azimuth_from_tank[:3, :3], at.azimuth_from_tank[:3, 3]
    packed[:9] = known_tank(view)[:3, :3].ravel()
    packed[9], packed[10], packed[23], packed[24:33], packed[33:36] = *at.centre_mm, turn.ravel(), shift
    levers = optics.outer_radius_mm * turn[1:, 0], [at.tank.front_mm + float(turn[:, 0] @ shift)]
    return tuple(round(float(part) / _TABLE_MM[0]) for part in np.concatenate(levers))


@dataclass
class Projected:
    """Where points lie in a view."""

    px: Vector2f
    """mi.Vector2f, pixels."""
    seen: Bool
    """mi.Bool, whether the view sees the point exactly once."""
    clear_mm: Float
    """mi.Float, horizontal distance within which everything else is seen exactly once as well."""
    du: Vector3f
    """mi.Vector3f, gradient of the column by the point, px/mm, canister frame."""
    dv: Vector3f
    """mi.Vector3f, gradient of the row by the point."""


def project(bank: ViewBank, view: UInt32, point: Point3f, active: Bool) -> Projected:
    """Project points into views, with the Jacobian.

    Parameters
    ----------
    view : mi.UInt32
        Index of the view.
    point : mi.Point3f
        Canister frame, mm, inside the water.
    active : mi.Bool
        Points to be projected.
    """
    quads = (_IN_OPEN if bank.optics.tank is None else _PARAMETERS) // 4
    some = [dr.gather(mi.Vector4f, bank.parameters, view * (_PARAMETERS // 4) + k, active) for k in range(quads)]  # four at once
    parameter = [value for four in some for value in four]
    c, s = parameter[11:13]
    at = c * point.x - s * point.y, s * point.x + c * point.y, point.z
    end = _in_open(bank, view, parameter, at, active) if bank.optics.tank is None else _through_tank(bank, view, parameter, at, active)
    ray, seen, clear_mm = end.ray, end.seen, end.clear_mm
    u, v, in_front, (u_b, u_p, v_b, v_p) = end.pixel

    # implicit function theorem: d(b, p) = -J^-1 df, or d(q_y, q_z), with df1 = nu . dP and df2 = m_w t . dP - dP_z
    f1_x, f1_y, f2_x, f2_y = -ray.sin_d, ray.cos_d, -ray.m_w * ray.cos_d, -ray.m_w * ray.sin_d
    by = (f1_x, f2_x), (f1_y, f2_y), (0.0, -1.0)
    b_x, b_y, b_z = (-ray.inv * (ray.f2_p * g1 - ray.f1_p * g2) for g1, g2 in by)
    p_x, p_y, p_z = (-ray.inv * (ray.f1_b * g2 - ray.f2_b * g1) for g1, g2 in by)
    u_az, v_az = u_b * b_x + u_p * p_x, v_b * b_x + v_p * p_x
    u_ay, v_ay = u_b * b_y + u_p * p_y, v_b * b_y + v_p * p_y
    du = mi.Vector3f(c * u_az + s * u_ay, c * u_ay - s * u_az, u_b * b_z + u_p * p_z)
    dv = mi.Vector3f(c * v_az + s * v_ay, c * v_ay - s * v_az, v_b * b_z + v_p * p_z)
    return Projected(mi.Vector2f(u, v), seen & in_front, clear_mm, du, dv)


@dataclass
class _End:
    """The ray to a point, and its pixel; derivatives by (b, p), or by (q_y, q_z) through a tank."""

    ray: _Ray
    seen: Bool
    clear_mm: Float
    pixel: Pixel


def _in_open(bank: ViewBank, view: UInt32, parameter: list[Float], at: tuple[Float, Float, Float], active: Bool) -> _End:
    """Find the rays of cameras in the open to points in the azimuth frame."""
    o = bank.optics
    rho, z_cam, n_w = parameter[9:11] + parameter[22:23]
    seen, clear_mm, b, p = _first_ray(bank, view, parameter, at, active)
    limit, per_radii = _FLANK * o.w_limit * o.outer_radius_mm, 1 / (rho * (o.outer_radius_mm * o.inner_radius_mm) ** 2)
    for step in range(NEWTON_STEPS + 1):
        ray = _follow(o, n_w, _from_camera(o, (rho, z_cam, per_radii), b, p), at, b, p)
        if step < NEWTON_STEPS:
            b = dr.clip(b - ray.inv * (ray.f2_p * ray.f1 - ray.f1_p * ray.f2), -limit, limit)
            p = dr.clip(p - ray.inv * (ray.f1_b * ray.f2 - ray.f2_b * ray.f1), -_STEEPEST, _STEEPEST)
    seen &= (dr.abs(ray.f1) < NEAR_MM) & (dr.abs(ray.f2) < NEAR_MM)
    seen &= (ray.entry_z < o.water_z_mm) & (ray.entry_z > o.floor_z_mm) & (ray.outer_z > o.bottom_z_mm)
    return _End(ray, seen, clear_mm, _pixel(parameter, b, p, ray))


def _through_tank(bank: ViewBank, view: UInt32, parameter: list[Float], at: tuple[Float, Float, Float], active: Bool) -> _End:
    """Find the rays through a tank's front to points in the azimuth frame."""
    o, tank = bank.optics, bank.optics.tank
    if tank is None:
        raise ValueError(f"{tank=} but expected a tank")
    n_w = parameter[22]
    place = Place(centre=[parameter[9], parameter[10], parameter[23]], turn=parameter[24:33], shift=parameter[33:36])
    start = _start(bank, view, at, at[1], active)
    clear_mm, q_y, q_z = start.y, start.x, window.straight(tank, place, mi.Point3f(*at))[1]
    for step in range(TANK_STEPS + 1):
        line = window.line(tank, place, q_y, q_z, bottom_z_mm=o.bottom_z_mm)
        p2 = line.p * line.p
        least = dr.minimum(n_w * n_w, o.n_wall**2) - p2
        limit = _FLANK * dr.minimum(o.inner_radius_mm * dr.sqrt(least) * dr.rsqrt(o.n_around**2 - p2), o.outer_radius_mm)
        b = dr.clip(line.b, -limit, limit)
        ray = _by_rays(_follow(o, n_w, _from_line(o, line, b), at, b, line.p), line, at)
        if step < TANK_STEPS:
            # b follows q_y nearly in proportion: back to where it was drawn in, and on by Newton's step
            q_y -= (line.b - b) / line.b_q[0] + ray.inv * (ray.f2_p * ray.f1 - ray.f1_p * ray.f2)
            q_z = dr.clip(q_z - ray.inv * (ray.f1_b * ray.f2 - ray.f2_b * ray.f1), -_STEEPEST, _STEEPEST)
            q_y = dr.clip(q_y, -_STEEPEST, _STEEPEST) * dr.minimum(1.0, _STEEPEST * dr.rsqrt(q_y * q_y + q_z * q_z))
    seen = active & (clear_mm > 0.5 * CELL_MM) & line.through & (dr.abs(line.b) < limit)
    seen &= (dr.abs(ray.f1) < NEAR_MM) & (dr.abs(ray.f2) < NEAR_MM) & (ray.outer_z < tank.level_mm)
    seen &= (ray.entry_z < o.water_z_mm) & (ray.entry_z > o.floor_z_mm) & (ray.outer_z > o.bottom_z_mm)
    ahead = dr.sqrt(1 - q_y * q_y - q_z * q_z)
    zero, one = mi.Float(0.0), mi.Float(1.0)
    pixel = _lens(parameter, (-ahead, q_y, q_z), (q_y / ahead, one, zero), (q_z / ahead, zero, one))
    return _End(ray, seen, clear_mm, pixel)


def _first_ray(
    bank: ViewBank, view: UInt32, parameter: list[Float], at: tuple[Float, Float, Float], active: Bool
) -> tuple[Bool, Float, Float, Float]:
    """Guess the ray to points in the azimuth frame from the view's table.

    Returns
    -------
    seen : mi.Bool
        Whether the view sees the point exactly once.
    clear_mm : mi.Float
        Horizontal distance within which everything else is seen exactly once as well.
    b, p : mi.Float
        Impact parameter in air, mm, and climb p_z of the ray.
    """
    o, (x, y, z) = bank.optics, at
    r_o, r_i = o.outer_radius_mm, o.inner_radius_mm
    rho, z_cam, n_w = parameter[9:11] + parameter[22:23]
    start = _start(bank, view, at, dr.abs(y) - np.ceil(r_i), active)
    b = dr.select(y < 0, -start.x, start.x)
    limit = _FLANK * o.w_limit * r_o
    b = dr.clip(b, -limit, limit)
    # p_z from the straight line of equal optical lengths
    b_w0 = b / n_w
    c_w0 = dr.sqrt(r_i * r_i - b_w0 * b_w0)
    length = dr.sqrt(rho * rho - b * b) - dr.sqrt(r_o * r_o - b * b) + (r_o - r_i) / o.n_wall
    length += (c_w0 + dr.safe_sqrt(x * x + y * y - b_w0 * b_w0) * dr.select(x < 0, 1.0, -1.0)) / n_w
    p = (z - z_cam) * dr.rsqrt(dr.square(z - z_cam) + dr.square(length))
    return active & (start.y > 0.5 * CELL_MM), start.y, b, p


def _start(bank: ViewBank, view: UInt32, at: tuple[Float, Float, Float], row_mm: Float, active: Bool) -> Vector2f:
    """Read the views' tables over (x, ``row_mm``), as they count from the wall on."""
    ny, nx = bank.table_shape
    most = np.ceil(bank.optics.inner_radius_mm) + 1.0
    col = dr.clip(at[0] + most, 0.0, nx - 1.001)  # so that there is a column beyond
    row = dr.clip(row_mm + most, 0.0, ny - 1.001)  # as the column
    return bilinear(bank.tables, view * (ny * nx), nx, col, row, active, kind=mi.Vector2f)


@dataclass
class _Near:
    """A ray up to the outer wall, and how that follows b and p (heading and foot of a line in a tank being given)."""

    turn: tuple[Float, Float]
    """Heading less pi inside the outer wall's normal, as a product of unit complex numbers times radii ..."""
    per_radii: Float
    """... and one over these, with those of the wall and the water."""
    turn_b: Float
    outer_z: Float
    z_b: Float
    z_p: Float


@dataclass
class _Ray:
    """A ray and how far it misses a point, all mi.Float, in the symbols of `optics.refraction`."""

    f1: Float
    """Horizontal distance from the point, mm."""
    f2: Float
    """Vertical distance, mm."""
    f1_b: Float
    """Derivatives of both by impact parameter b and climb p ..."""
    f1_p: Float
    f2_b: Float
    f2_p: Float
    inv: Float
    """... and one over their determinant."""
    cos_d: Float
    """Of the heading in the water less pi."""
    sin_d: Float
    m_w: Float
    """Climb in the water, mm a horizontal mm."""
    h_a: Float
    """Horizontal part of the optical direction in air ..."""
    h_a2: Float
    """... and its square."""
    outer_z: Float
    """Height at which the ray enters the wall, mm."""
    entry_z: Float
    """Height at which it enters the water, mm."""


def _from_camera(o: Optics, view: tuple[Float, Float, Float], b: Float, p: Float) -> _Near:
    """Follow rays through the air from a camera to the outer wall.

    Parameters
    ----------
    view : tuple of mi.Float
        Distance and height of the camera, and one over the product of the radii.
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
    return _Near((c_o * c_r + b * b, b * (c_r - c_o)), per_radii, ic_o - ic_r, z_cam + m_a * s_a, m_a * s_a_b, s_a * ih_a2 * ih_a)


def _from_line(o: Optics, line: window.Line, b: Float) -> _Near:
    """Follow lines in a tank's liquid to the outer wall, which they meet with the impact parameter b."""
    ih = dr.rsqrt(o.n_around**2 - line.p * line.p)
    c_o2 = o.outer_radius_mm**2 - b * b
    ic_o = dr.rsqrt(c_o2)
    c_o, climb = c_o2 * ic_o, line.p * ih
    turn = line.cos_h * c_o - line.sin_h * b, line.sin_h * c_o + line.cos_h * b
    z_b, z_p = climb * b * ic_o, -(o.n_around**2) * c_o * ih * ih * ih
    return _Near(turn, mi.Float(1 / (o.outer_radius_mm * o.inner_radius_mm) ** 2), ic_o, line.foot_z - climb * c_o, z_b, z_p)


def _by_rays(ray: _Ray, line: window.Line, at: tuple[Float, Float, Float]) -> _Ray:
    """Return a ray with the derivatives of its misses by (q_y, q_z) in place of those by b and p."""
    along, beside = -at[0] * ray.cos_d - at[1] * ray.sin_d, -at[0] * ray.sin_d + at[1] * ray.cos_d
    f1 = [ray.f1_b * line.b_q[j] + ray.f1_p * line.p_q[j] + along * line.h_q[j] for j in (0, 1)]
    f2 = [ray.f2_b * line.b_q[j] + ray.f2_p * line.p_q[j] - ray.m_w * beside * line.h_q[j] + line.z_q[j] for j in (0, 1)]
    return replace(ray, f1_b=f1[0], f1_p=f1[1], f2_b=f2[0], f2_p=f2[1], inv=1 / (f1[0] * f2[1] - f1[1] * f2[0]))


def _follow(o: Optics, n_w: Float, near: _Near, at: tuple[Float, Float, Float], b: Float, p: Float) -> _Ray:
    """Follow rays through wall and water to points in the azimuth frame."""
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
    # along the line to its nearest point to the axis, from where it crosses each radius: c, and 1 / c
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
    # f and its Jacobian by (b, p)
    m_g, m_w = p * ih_g, p * ih_w  # climbs
    s_g, s_w = c_og - c_ig, along + c_w
    f1_b, f1_p = along * delta_b - k_w, along * delta_p - b_w_p
    s_g_bg, s_w_bw = b_g * (ic_ig - ic_og), b_w * ic_w
    f2_b = near.z_b + m_g * s_g_bg * k_g - m_w * (beside * delta_b + s_w_bw * k_w)
    f2_p = near.z_p + o.n_wall**2 * s_g * ih_g * ih_g2 + n_w**2 * s_w * ih_w * ih_w2
    f2_p += m_g * s_g_bg * b_g_p - m_w * (beside * delta_p + s_w_bw * b_w_p)
    f2 = near.outer_z + m_g * s_g + m_w * s_w - z
    inv = 1 / (f1_b * f2_p - f1_p * f2_b)
    return _Ray(beside - b_w, f2, f1_b, f1_p, f2_b, f2_p, inv, cos_d, sin_d, m_w, h_a, h_a2, near.outer_z, near.outer_z + m_g * s_g)


Pixel = tuple[Float, Float, Bool, tuple[Float, Float, Float, Float]]
"""Column and row of rays, whether they come from in front, and the derivatives of column and row by two unknowns."""


def _pixel(parameter: list[Float], b: Float, p: Float, ray: _Ray) -> Pixel:
    """Return the pixels of rays of cameras in the open, with derivatives by (b, p)."""
    rho, h_a = parameter[9], ray.h_a
    # direction in air, and its derivatives by (b, p)
    d_y = b * h_a / rho
    q = dr.sqrt(ray.h_a2 - d_y * d_y)
    d_y_b, d_y_p = h_a / rho, -b * p / (h_a * rho)
    d_x_b, d_x_p = d_y * d_y_b / q, (p + d_y * d_y_p) / q
    return _lens(parameter, (-q, d_y, p), (d_x_b, d_y_b, mi.Float(0.0)), (d_x_p, d_y_p, mi.Float(1.0)))


def _lens(parameter: list[Float], direction: tuple[Float, ...], by_1: tuple[Float, ...], by_2: tuple[Float, ...]) -> Pixel:
    """Return the pixels of directions before the camera's turn, whose derivatives by two unknowns are given."""
    r = parameter[:9]
    (cx, cy, cz), (cx_b, cy_b, cz_b), (cx_p, cy_p, cz_p) = (
        [r[3 * i] * d[0] + r[3 * i + 1] * d[1] + r[3 * i + 2] * d[2] for i in range(3)] for d in (direction, by_1, by_2)
    )
    iz = 1 / cz
    xn, yn = cx * iz, cy * iz
    xn_b, yn_b = (cx_b - xn * cz_b) * iz, (cy_b - yn * cz_b) * iz
    xn_p, yn_p = (cx_p - xn * cz_p) * iz, (cy_p - yn * cz_p) * iz
    # lens
    k1, k2, p1, p2_, k3 = parameter[17:22]
    r2 = xn * xn + yn * yn
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    radial_r2 = k1 + r2 * (2 * k2 + 3 * r2 * k3)
    u = xn * radial + 2 * p1 * xn * yn + p2_ * (r2 + 2 * xn * xn)
    v = yn * radial + p1 * (r2 + 2 * yn * yn) + 2 * p2_ * xn * yn
    u_x = radial + 2 * xn * xn * radial_r2 + 2 * p1 * yn + 6 * p2_ * xn
    u_y = 2 * xn * yn * radial_r2 + 2 * p1 * xn + 2 * p2_ * yn
    v_y = radial + 2 * yn * yn * radial_r2 + 6 * p1 * yn + 2 * p2_ * xn
    fx, fy, px0, py0 = parameter[13:17]
    u_b, u_p = fx * (u_x * xn_b + u_y * yn_b), fx * (u_x * xn_p + u_y * yn_p)
    v_b, v_p = fy * (u_y * xn_b + v_y * yn_b), fy * (u_y * xn_p + v_y * yn_p)
    return fx * u + px0, fy * v + py0, cz > 0, (u_b, u_p, v_b, v_p)
