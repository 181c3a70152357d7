"""Projection of points in the water through the canister into many views, as a fast kernel (Dr.Jit, float32).

The mathematics and symbols are those of `recon.optics.refraction`. The two equations of a projection,

    f1 = P . nu - b_w = 0                                               the point lies beside the line
    f2 = z_entry + p_z / h_w (P . t + sqrt(R_i^2 - b_w^2)) - P_z = 0    and at its height

are solved for (b_a, p_z) by Newton's method with the analytic Jacobian. The initial values are taken from a small table
per view. The water acts as a lens, and may show a point twice. Points that a view shows twice are treated like points
that it does not show, that is, the view provides no information about them. Through a tank's front, the unknowns are
the components (q_y, q_z) of the ray along the front (`recon.optics.tank`), from which `optics.window` computes the line
in the liquid. From the canister's wall on, the equations are the same.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import drjit as dr
import mitsuba as mi
import numpy as np

from rhizotwin.recon.device import Bool, Float, Point3f, UInt32, Vector2f, Vector3f, bilinear, numbers, points
from rhizotwin.recon.optics import ray_kernel, window
from rhizotwin.recon.optics.cameras import View, tank_pose, tank_view
from rhizotwin.recon.optics.refraction import Array, Optics
from rhizotwin.recon.optics.start_tables import ALL_CLEAR_MM, CELL_MM, direct_table, tank_table
from rhizotwin.recon.optics.window import Place
from rhizotwin.scenes import frames, lens

_PARAMETERS = 44
"""Number of kernel parameters per view. It must be a multiple of four, because four parameters are read at a time."""
_PRINCIPAL = slice(15, 17)
"""Indices of the principal point, px, in a view's parameters."""
_IN_OPEN, _SWAY = 24, 40
"""Two positions in a view's parameters. The first is the number of leading parameters that are used without a tank. The
second is the index of the first sway parameter."""
NEWTON_STEPS, TANK_STEPS = 3, 4
"""Number of Newton steps without a tank, and through a tank. Rays through a tank have no symmetry from which an initial
value could be computed, and need more steps."""
_FLANK, _STEEPEST = 0.9995, 0.98
"""Upper limits of a ray's impact parameter and of its vertical component in Newton's method, as fractions of the
largest possible values. At the largest values, the derivatives are infinite."""
_TABLE_MM = 0.2, 2.0
"""Two tolerances for views that share a start table, mm. The first is the difference between the cameras' distances
from the axis, and the second is the difference between their heights. With a tank, its pose is also compared, by the
displacement that a change of the pose causes at the wall. Newton's method compensates for the differences."""


@dataclass(frozen=True)
class ViewBank:
    """Views of a dataset, packed for the projection kernel."""

    optics: Optics
    """Optics of the canister, shared by all views."""
    count: int
    """Number of views."""
    parameters: Float
    """mi.Float, (V, `_PARAMETERS`) flattened: kernel parameters of each view."""
    tables: Float
    """mi.Float, (V, ny, nx, 2) flattened: start table of each view."""
    table_shape: tuple[int, int]
    """Number of rows and columns of a start table."""
    end: UInt32 = field(init=False, repr=False)
    """mi.UInt32, number of views as a kernel input. As a literal, the number would cause a new kernel to be compiled
    for every number of views."""

    def __post_init__(self) -> None:
        """Copy the number of views to the device."""
        object.__setattr__(self, "end", dr.opaque(mi.UInt32, self.count))

    @staticmethod
    def pack(views: Sequence[View], optics: Optics) -> ViewBank:
        """Pack views for the kernel.

        Views whose camera distances and heights agree within `_TABLE_MM` use copies of the same start table.
        """
        packed = np.zeros((len(views), _PARAMETERS))
        made: dict[tuple[float, ...], Array] = {}
        tables, (step_rho, step_z) = [], _TABLE_MM
        for k, view in enumerate(views):
            cam_from_azimuth = view.cam_from_canister @ frames.invert(view.azimuth_from_canister)
            turn = view.azimuth_from_canister
            packed[k, :9] = cam_from_azimuth[:3, :3].ravel()
            packed[k, 9:13] = view.rho_mm, view.centre_mm[2], turn[0, 0], turn[1, 0]
            packed[k, 13:15], packed[k, _PRINCIPAL] = view.camera.focal_px, view.camera.principal_px
            packed[k, 17:22] = view.camera.distortion
            packed[k, 22] = optics.n_water  # not a literal of the kernel, as it may change
            packed[k, 23] = lens.fold_r2(view.camera.distortion)
            packed[k, _SWAY:] = *view.sway, optics.water_z_mm
            camera_mm = step_rho * round(view.rho_mm / step_rho), step_z * round(float(view.centre_mm[2]) / step_z)
            if optics.unobstructed:
                tables.append(np.zeros((1, 1, 2)))  # not used
            elif optics.tank is None:
                tables.append(direct_table(*camera_mm, optics))
            else:
                key = *camera_mm, *_pack_tank(packed[k], view, optics)
                if key not in made:
                    made[key] = tank_table(view, optics)
                tables.append(made[key])
        shape = tables[0].shape[:2]
        return ViewBank(optics, len(views), numbers(packed), numbers(np.stack(tables)), (shape[0], shape[1]))

    def crop(self, low_px: tuple[int, int]) -> ViewBank:
        """Return the views with pixel coordinates relative to the first column and row of a window."""
        packed = np.array(self.parameters).reshape(self.count, -1)
        packed[:, _PRINCIPAL] -= low_px
        return replace(self, parameters=numbers(packed))

    def select(self, which: Sequence[int]) -> ViewBank:
        """Return the views with the given indices."""
        parts = (np.array(part).reshape(self.count, -1)[list(which)] for part in (self.parameters, self.tables))
        parameters, tables = (numbers(part) for part in parts)
        return ViewBank(self.optics, len(which), parameters, tables, self.table_shape)


def _pack_tank(packed: Array, view: View, optics: Optics) -> tuple[int, ...]:
    """Write the pose of the tank into a view's parameters, and return the view's key.

    Views with the same key share a start table.
    """
    at = tank_view(view, optics)
    turn, shift = at.azimuth_from_tank[:3, :3], at.azimuth_from_tank[:3, 3]
    packed[:9] = tank_pose(view)[:3, :3].ravel()
    packed[9], packed[10], packed[36], packed[24:33], packed[33:36] = *at.centre_mm, turn.ravel(), shift
    levers = optics.outer_radius_mm * turn[1:, 0], [at.tank.front_mm + float(turn[:, 0] @ shift)]
    return tuple(round(float(part) / _TABLE_MM[0]) for part in np.concatenate(levers))


@dataclass
class Projected:
    """Projections of points into views."""

    px: Vector2f
    """mi.Vector2f, pixel coordinates, px."""
    visible: Bool
    """mi.Bool, whether the view shows the point exactly once."""
    clear_mm: Float
    """mi.Float, horizontal distance within which the view shows all neighbouring points exactly once, mm."""
    du: Vector3f
    """mi.Vector3f, gradient of the picture column with respect to the point in the canister frame, px/mm."""
    dv: Vector3f
    """mi.Vector3f, gradient of the picture row with respect to the point in the canister frame, px/mm."""


def project(bank: ViewBank, view: UInt32, point: Point3f, active: Bool) -> Projected:
    """Project points into views, with derivatives.

    Parameters
    ----------
    view : mi.UInt32
        Index of the view of each point.
    point : mi.Point3f
        Points in the water, canister frame, mm.
    active : mi.Bool
        Whether each point is projected.
    """
    quads = (_IN_OPEN if bank.optics.tank is None else _SWAY) // 4
    some = [dr.gather(mi.Vector4f, bank.parameters, view * (_PARAMETERS // 4) + k, active) for k in range(quads)]  # four at a time
    parameter = [value for four in some for value in four]
    c, s = parameter[11:13]
    sway = dr.gather(mi.Vector4f, bank.parameters, view * (_PARAMETERS // 4) + _SWAY // 4, active)
    deep = sway.w - point.z
    aside, along, turned = sway.x - sway.z * point.y, sway.y + sway.z * point.x, sway.z * deep
    x, y = point.x + aside * deep, point.y + along * deep
    at = c * x - s * y, s * x + c * y, point.z
    if bank.optics.unobstructed:
        found = _project_straight(parameter, at, active)
    else:
        found = (_solve_direct if bank.optics.tank is None else _solve_tank)(bank, view, parameter, at, active)
    for by_point in (found.du, found.dv):  # from the azimuth frame to the canister frame, and through the sway
        by_point.x, by_point.y = c * by_point.x + s * by_point.y, c * by_point.y - s * by_point.x
        by_point.z -= by_point.x * aside + by_point.y * along
        by_point.x, by_point.y = by_point.x + by_point.y * turned, by_point.y - by_point.x * turned
    return found


def project_into_all(bank: ViewBank, points_mm: Array) -> Projected:
    """Project points (N, 3), canister frame, mm, into all views.

    The result is flattened (V, N), and is not evaluated.
    """
    view, point = pair_all(bank.count, len(points_mm))
    return project(bank, view, dr.gather(mi.Point3f, points(points_mm), point), mi.Bool(True))


def pair_all(views: int, count: int) -> tuple[UInt32, UInt32]:
    """Return the indices of view and point (mi.UInt32) of each element of a flattened array (V, N)."""
    lane, points_a_view = dr.arange(mi.UInt32, views * count), dr.opaque(mi.UInt32, count)
    view = lane // points_a_view
    return view, lane - view * points_a_view


def px_a_mm(bank: ViewBank, point_mm: Array) -> float:
    """Return the scale of the pictures at a point, px/mm.

    It is the median over the views that show the point. If no view shows the point, it is the median over all views.

    Parameters
    ----------
    point_mm : (3,) float64 array
        Canister frame.
    """
    at = np.repeat(np.asarray(point_mm, np.float64)[None], bank.count, axis=0)
    p = project(bank, dr.arange(mi.UInt32, bank.count), mi.Point3f(*(numbers(part) for part in at.T)), mi.Bool(True))
    scale, visible = np.array(dr.sqrt(dr.norm(p.du) * dr.norm(p.dv))), np.array(p.visible)
    return float(np.median(scale[visible] if visible.any() else scale))


def _project_straight(parameter: list[Float], at: tuple[Float, Float, Float], active: Bool) -> Projected:
    """Project points in the azimuth frame along straight rays that nothing obstructs.

    The gradients are with respect to the point in the azimuth frame.
    """
    away, axes = (at[0] - parameter[9], at[1], at[2] - parameter[10]), [mi.Vector3f(*axis) for axis in np.eye(3).tolist()]
    u, v, in_view, du, dv = ray_kernel.through_lens(parameter, away, (axes[0], axes[1], axes[2]))
    return Projected(mi.Vector2f(u, v), active & in_view, mi.Float(ALL_CLEAR_MM), du, dv)


def _from_ray(ray: ray_kernel.Ray, visible: Bool, clear_mm: Float, pixel: ray_kernel.Pixel) -> Projected:
    """Return the projections of points, given the rays that reach them.

    The gradients of ray and pixel are with respect to (b, p) or, through a tank, (q_y, q_z). The gradients of the
    result are with respect to the point in the azimuth frame.
    """
    u, v, in_view, *by_unknown = pixel
    # implicit function theorem: dq = -J^-1 df with df1 = nu . dP and df2 = m_w t . dP - dP_z
    by_point = (-ray.sin_d, -ray.m_w * ray.cos_d), (ray.cos_d, -ray.m_w * ray.sin_d), (0.0, -1.0)
    steps = [ray.solve(*by) for by in by_point]
    du, dv = (-mi.Vector3f(*(by.x * step.x + by.y * step.y for step in steps)) for by in by_unknown)
    return Projected(mi.Vector2f(u, v), visible & in_view, clear_mm, du, dv)


def _solve_direct(bank: ViewBank, view: UInt32, parameter: list[Float], at: tuple[Float, Float, Float], active: Bool) -> Projected:
    """Find the rays from cameras without a tank to points in the azimuth frame."""
    o = bank.optics
    rho, z_cam, n_w = parameter[9:11] + parameter[22:23]
    visible, clear_mm, b, p = _first_ray(bank, view, parameter, at, active)
    limit, per_radii = _FLANK * o.w_limit * o.outer_radius_mm, 1 / (rho * (o.outer_radius_mm * o.inner_radius_mm) ** 2)
    for step in range(NEWTON_STEPS + 1):
        near = ray_kernel.from_camera(o, (rho, z_cam, per_radii), b, p)
        ray = ray_kernel.follow(o, n_w, near, at)
        if step < NEWTON_STEPS:
            change = ray.solve(ray.f1, ray.f2)
            b, p = dr.clip(b - change.x, -limit, limit), dr.clip(p - change.y, -_STEEPEST, _STEEPEST)
    return _from_ray(ray, visible & ray.arrives(o), clear_mm, ray_kernel.direct_pixel(parameter, near, ray))


def _solve_tank(bank: ViewBank, view: UInt32, parameter: list[Float], at: tuple[Float, Float, Float], active: Bool) -> Projected:
    """Find the rays from cameras through a tank's front to points in the azimuth frame."""
    o, tank = bank.optics, bank.optics.tank
    if tank is None:
        raise ValueError(f"{tank=} but expected a tank")
    n_w = parameter[22]
    place = Place(centre=[parameter[9], parameter[10], parameter[36]], turn=parameter[24:33], shift=parameter[33:36])
    start = _start(bank, view, at, at[1], active)
    clear_mm, q_y, q_z = start.y, start.x, window.straight(tank, place, mi.Point3f(*at))
    for step in range(TANK_STEPS + 1):
        line = window.line(tank, place, q_y, q_z, bottom_z_mm=o.bottom_z_mm)
        p2 = line.p * line.p
        least = dr.minimum(n_w * n_w, o.n_wall**2) - p2
        limit = _FLANK * dr.minimum(o.inner_radius_mm * dr.sqrt(least) * dr.rsqrt(o.n_around**2 - p2), o.outer_radius_mm)
        b = dr.clip(line.b, -limit, limit)
        ray = ray_kernel.follow(o, n_w, ray_kernel.from_line(o, line, b), at)
        if step < TANK_STEPS:
            # b is almost proportional to q_y: undo the clipping, and add Newton's step.
            change = ray.solve(ray.f1, ray.f2)
            q_y -= (line.b - b) / line.b_q.x + change.x
            q_z = dr.clip(q_z - change.y, -_STEEPEST, _STEEPEST)
            q_y = dr.clip(q_y, -_STEEPEST, _STEEPEST) * dr.minimum(1.0, _STEEPEST * dr.rsqrt(q_y * q_y + q_z * q_z))
    visible = active & (clear_mm > 0.5 * CELL_MM) & line.through & (dr.abs(line.b) < limit)
    visible &= ray.arrives(o) & (ray.outer_z < tank.level_mm)
    ahead = dr.sqrt(1 - q_y * q_y - q_z * q_z)
    by = mi.Vector2f(q_y, q_z) / ahead, mi.Vector2f(1, 0), mi.Vector2f(0, 1)
    return _from_ray(ray, visible, clear_mm, ray_kernel.through_lens(parameter, (-ahead, q_y, q_z), by))


def _first_ray(
    bank: ViewBank, view: UInt32, parameter: list[Float], at: tuple[Float, Float, Float], active: Bool
) -> tuple[Bool, Float, Float, Float]:
    """Return the initial rays to points in the azimuth frame, interpolated from the start tables of the views.

    Returns
    -------
    visible : mi.Bool
        Whether the view shows the point exactly once.
    clear_mm : mi.Float
        Horizontal distance within which the view shows all neighbouring points exactly once, mm.
    b, p : mi.Float
        Impact parameter in air, mm, and vertical component p_z of the initial ray.
    """
    o, (x, y, z) = bank.optics, at
    r_o, r_i = o.outer_radius_mm, o.inner_radius_mm
    rho, z_cam, n_w = parameter[9:11] + parameter[22:23]
    start = _start(bank, view, at, dr.abs(y) - np.ceil(r_i), active)
    b = dr.select(y < 0, -start.x, start.x)
    limit = _FLANK * o.w_limit * r_o
    b = dr.clip(b, -limit, limit)
    # Compute p_z from the straight line of equal optical length.
    b_w0 = b / n_w
    c_w0 = dr.sqrt(r_i * r_i - b_w0 * b_w0)
    length = dr.sqrt(rho * rho - b * b) - dr.sqrt(r_o * r_o - b * b) + (r_o - r_i) / o.n_wall
    length += (c_w0 + dr.safe_sqrt(x * x + y * y - b_w0 * b_w0) * dr.select(x < 0, 1.0, -1.0)) / n_w
    p = (z - z_cam) * dr.rsqrt(dr.square(z - z_cam) + dr.square(length))
    return active & (start.y > 0.5 * CELL_MM), start.y, b, p


def _start(bank: ViewBank, view: UInt32, at: tuple[Float, Float, Float], row_mm: Float, active: Bool) -> Vector2f:
    """Interpolate the start tables of the views.

    Columns of a table correspond to the x coordinate of the point, mm, and rows to the position ``row_mm``.
    """
    ny, nx = bank.table_shape
    most = np.ceil(bank.optics.inner_radius_mm) + 1.0
    col = dr.clip(at[0] + most, 0.0, nx - 1.001)  # below the last column
    row = dr.clip(row_mm + most, 0.0, ny - 1.001)  # below the last row
    return bilinear(bank.tables, view * (ny * nx), nx, col, row, active, kind=mi.Vector2f)
