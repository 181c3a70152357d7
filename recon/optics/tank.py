"""Lines of sight through the flat front of a tank about the canister, and its round wall (float64 reference).

A flat wall conserves the components of the optical direction ``p = n d`` along it, here ``(q_y, q_z)`` in the tank's
frame (that of the rig, the front's normal +x): with ``a_i = sqrt(n_i^2 - q_y^2 - q_z^2)`` a ray that crosses the
thickness t of medium i goes aside by ``t q / a_i``. So a camera ray, named by (q_y, q_z), is a known straight line in
the liquid. In the canister's frame, which may be turned, lean and stand aside, its ``p_z`` and its angular momentum
``L = x p_y - y p_x`` are conserved by the round walls (see `recon.optics.refraction`), and the line in the water
follows in closed form. Nothing depends on where the camera stands or looks.

The point P lies on the line when ``f1 = P . nu - b_w = 0`` and ``f2 = z(P) - P_z = 0``: two equations for (q_y, q_z),
solved by Newton's method. A point that has a second image next to the wall, where the shell bends most, gets the one
nearer to its straight line.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.optics.cameras import View, camera_directions, direction_pixels
from rhizotwin.recon.optics.refraction import Array, Optics, WaterLine, height_at
from rhizotwin.scenes import frames
from rhizotwin.scenes.model import Scene, Tank

_STEPS = 30
"""Newton's steps at most; a damped one may need some near the wall."""
_CLOSE_MM = 1e-8
"""A ray that passes a point this near has found it."""
_DIFFERENCE = 1e-7
"""Step of the central differences in (q_y, q_z): half of double precision's digits."""


@dataclass(frozen=True, kw_only=True)
class TankView:
    """A view of a canister in a tank."""

    view: View
    canister_from_rig: Array
    """(4, 4) of this view: the table's angle and the canister's seat."""
    tank: Tank
    optics: Optics
    """Of the canister, as it is described: indices against air."""

    @staticmethod
    def of(scene: Scene, view: View, canister_from_rig: Array) -> "TankView":
        """Return a view of a scene that has a tank.

        Raises
        ------
        ValueError
            For a scene without one.
        """
        if scene.tank is None:
            raise ValueError("scene.tank=None but expected a tank")
        return TankView(view=view, canister_from_rig=canister_from_rig, tank=scene.tank, optics=Optics.of(replace(scene, tank=None)))

    @property
    def centre_mm(self) -> Array:
        """Camera centre (3,) in the tank's frame."""
        return frames.apply(frames.invert(self.canister_from_rig), self.view.centre_mm[None])[0]

    @property
    def cam_from_tank(self) -> Array:
        """4x4 pose of the camera in the tank's frame."""
        return np.asarray(self.view.cam_from_canister @ self.canister_from_rig)


def trace(at: TankView, q_y: Array, q_z: Array) -> tuple[WaterLine, NDArray[np.bool_]]:
    """Follow camera rays through the tank into the water.

    Parameters
    ----------
    at : TankView
        The view.
    q_y, q_z : (...) float64
        Components of the unit direction in air along the front.

    Returns
    -------
    line : WaterLine
        In the canister's frame; NaN where the ray misses the water.
    enters : (...) bool
        Whether it enters the water through the tank's front below its surface, and through the canister's wall.
    """
    tank, o = at.tank, at.optics
    q2 = q_y**2 + q_z**2
    x, y, z = at.centre_mm
    with np.errstate(invalid="ignore", divide="ignore"):
        a_air, a_wall, a_liquid = (np.sqrt(n**2 - q2) for n in (1.0, tank.n_wall, tank.n_liquid))
        aside = (x - tank.front_mm) / a_air + tank.wall_mm / a_wall
        inside = np.stack([np.full(np.shape(aside), tank.front_mm - tank.wall_mm), y + aside * q_y, z + aside * q_z], axis=-1)
        front_z = z + (x - tank.front_mm) / a_air * q_z
        p = np.stack([-a_liquid, np.broadcast_to(q_y, a_liquid.shape), np.broadcast_to(q_z, a_liquid.shape)], axis=-1)
        point = inside @ at.canister_from_rig[:3, :3].T + at.canister_from_rig[:3, 3]
        p_x, p_y, p_z = np.moveaxis(p @ at.canister_from_rig[:3, :3].T, -1, 0)
        momentum = point[..., 0] * p_y - point[..., 1] * p_x
        h_l, h_g, h_w = (np.sqrt(n**2 - p_z**2) for n in (tank.n_liquid, o.n_wall, o.n_water))
        b_l, b_g, b_w = momentum / h_l, momentum / h_g, momentum / h_w
        r_o, r_i = o.outer_radius_mm, o.inner_radius_mm
        heading = np.arctan2(p_y, p_x) + np.arcsin(b_l / r_o) - np.arcsin(b_g / r_o) + np.arcsin(b_g / r_i) - np.arcsin(b_w / r_i)
        before = -(point[..., 0] * p_x + point[..., 1] * p_y) / h_l  # along the line to its nearest point to the axis
        outer_z = point[..., 2] + p_z / h_l * (before - np.sqrt(r_o**2 - b_l**2))
        entry_z = outer_z + p_z / h_g * (np.sqrt(r_o**2 - b_g**2) - np.sqrt(r_i**2 - b_g**2))
        surface = tank.level_mm
        enters = np.isfinite(heading) & (front_z < surface) & (inside[..., 2] < surface) & (outer_z < surface)
        enters &= (np.abs(inside[..., 1]) < tank.half_width_mm - tank.wall_mm) & (outer_z > o.bottom_z_mm)
        enters &= (entry_z < o.water_z_mm) & (entry_z > o.floor_z_mm)
    return WaterLine(b_mm=b_w, heading_rad=heading, slope=p_z / h_w, entry_z_mm=entry_z, outer_z_mm=outer_z), enters


def _miss(at: TankView, points_mm: Array, q: Array) -> Array:
    """Return (f1, f2) in mm (N, 2) of the rays q (N, 2) against points (N, 3); NaN for rays that miss the water."""
    line, _ = trace(at, q[:, 0], q[:, 1])
    beside = np.sum(points_mm[:, :2] * line.nu, axis=-1) - line.b_mm
    with np.errstate(invalid="ignore"):
        return np.stack([beside, height_at(at.optics, line, points_mm[:, :2]) - points_mm[:, 2]], axis=-1)


def _slopes(miss: Callable[[Array], Array], q: Array) -> Array:
    """Return the derivatives (N, 2, 2) of the misses (rows) by q (columns)."""
    columns = []
    for k in (0, 1):
        step = np.zeros(2)
        step[k] = _DIFFERENCE
        columns.append((miss(q + step) - miss(q - step)) / (2.0 * _DIFFERENCE))
    return np.stack(columns, axis=-1)


def find_rays(at: TankView, points_mm: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Find the camera rays that end at water points.

    Parameters
    ----------
    points_mm : (N, 3) float64
        In the canister's frame, inside the water's radius.

    Returns
    -------
    q : (N, 2) float64
        Components of the rays' unit directions in air along the tank's front; NaN where none ends there.
    seen : (N,) bool
        Whether one was found that enters by the front and the wall.

    Notes
    -----
    The start is the straight line of the same apparent depth behind the front, all media taken for the liquid. A step
    that would lead to a ray that misses the water, or farther from the point, is halved.
    """
    in_tank = frames.apply(frames.invert(at.canister_from_rig), points_mm)
    x, y, z = at.centre_mm
    depth = (
        x - at.tank.front_mm + at.tank.wall_mm / at.tank.n_wall + (at.tank.front_mm - at.tank.wall_mm - in_tank[:, 0]) / at.tank.n_liquid
    )
    aside = in_tank[:, 1:] - [y, z]
    q = aside / np.sqrt(depth**2 + np.sum(aside**2, axis=1))[:, None]

    def miss(trial: Array) -> Array:
        return _miss(at, points_mm, trial)

    q = _brought_inside(at, q, miss)
    f = miss(q)
    for _ in range(_STEPS):
        size = np.linalg.norm(f, axis=1)
        if not (size > _CLOSE_MM).any():
            break
        slopes = _slopes(miss, q)
        good = np.asarray(np.isfinite(slopes).all(axis=(1, 2)) & np.isfinite(f).all(axis=1))
        good[good] &= np.abs(np.linalg.det(slopes[good])) > 1e-9
        step = np.zeros_like(q)
        step[good] = np.linalg.solve(slopes[good], f[good][..., None])[..., 0]
        share = np.ones(len(q))
        for _ in range(8):
            trial = q - share[:, None] * step
            f_trial = miss(trial)
            worse = ~(np.linalg.norm(f_trial, axis=1) <= size)
            if not (worse & good).any():
                break
            share[worse] *= 0.5
        better = np.linalg.norm(f_trial, axis=1) <= size
        q[better], f[better] = trial[better], f_trial[better]
    seen = (np.linalg.norm(f, axis=1) < 1e2 * _CLOSE_MM) & trace(at, q[:, 0], q[:, 1])[1]
    return np.where(seen[:, None], q, np.nan), seen


def _brought_inside(at: TankView, q: Array, miss: Callable[[Array], Array]) -> Array:
    """Pull rays that miss the water towards the one that goes for the axis, until they do not."""
    middle = frames.apply(frames.invert(at.canister_from_rig), np.array([[0.0, 0.0, at.optics.floor_z_mm]]))[0]
    x, y, _ = at.centre_mm
    aim = (middle[1] - y) / np.hypot(x - middle[0], middle[1] - y)
    q = q.copy()
    for _ in range(40):
        out = ~np.isfinite(miss(q)).all(axis=1)
        if not out.any():
            break
        q[out, 0] = aim + 0.95 * (q[out, 0] - aim)  # 40 of these leave an eighth of the way
    return q


def project(at: TankView, points_mm: Array) -> tuple[Array, NDArray[np.bool_], Array]:
    """Project water points through the tank into a view, with the Jacobian.

    Parameters
    ----------
    points_mm : (N, 3) float64
        In the canister's frame, inside the water's radius.

    Returns
    -------
    px : (N, 2) float64
        Pixels; NaN where the view does not see the point.
    seen : (N,) bool
    jacobian : (N, 2, 3) float64
        Of the pixel by the point, px/mm, by the implicit function theorem: ``dq = -(df/dq)^-1 df/dP``.
    """
    q, seen = find_rays(at, points_mm)
    px = _pixels(at, q)
    by_ray = np.stack([(_pixels(at, q + step) - _pixels(at, q - step)) / (2.0 * _DIFFERENCE) for step in _DIFFERENCE * np.eye(2)], axis=-1)
    slopes = _slopes(lambda trial: _miss(at, points_mm, trial), q)
    line, _ = trace(at, q[:, 0], q[:, 1])
    # f1 = P . nu - b and f2 = entry + slope (P . t + ...) - P_z: their derivatives by P
    by_point = np.zeros((len(q), 2, 3))
    by_point[:, 0, :2], by_point[:, 1, :2], by_point[:, 1, 2] = line.nu, line.slope[:, None] * line.t, -1.0
    jacobian = np.full((len(q), 2, 3), np.nan)
    jacobian[seen] = -by_ray[seen] @ np.linalg.solve(slopes[seen], by_point[seen])
    return px, seen, jacobian


def _pixels(at: TankView, q: Array) -> Array:
    """Return the pixels (N, 2) of rays by their components along the front."""
    with np.errstate(invalid="ignore"):
        direction = np.column_stack([-np.sqrt(1.0 - np.sum(q**2, axis=1)), q])
    rig = View(camera=at.view.camera, cam_from_canister=at.cam_from_tank)  # the tank's frame takes the canister's place
    return direction_pixels(rig, direction @ rig.azimuth_from_canister[:3, :3].T)


def water_lines(at: TankView, px: Array) -> tuple[WaterLine, NDArray[np.bool_]]:
    """Follow pixels (N, 2) through the tank into the water: the lines in the canister's frame, and which enter it."""
    directions = camera_directions(at.view.camera, px) @ np.linalg.inv(at.cam_from_tank)[:3, :3].T
    return trace(at, directions[:, 1], directions[:, 2])


def images_at_height(at: TankView, points_mm: Array, *, rays: int = 4001) -> NDArray[np.int64]:
    """Count the images (N,) of points in a level camera's own plane, the canister upright, by a sweep of rays.

    A point has an image between two neighbouring rays when it lies to the left of one and to the right of the other.
    """
    q = np.linspace(-0.7, 0.7, rays)  # 44 degrees to either side, more than any tank fills
    line, enters = trace(at, q, np.zeros_like(q))
    side = points_mm[:, :1] * line.nu[:, 0] + points_mm[:, 1:2] * line.nu[:, 1] - line.b_mm
    with np.errstate(invalid="ignore"):
        change = np.signbit(side[:, 1:]) != np.signbit(side[:, :-1])
    return np.asarray((change & enters[1:] & enters[:-1]).sum(axis=1))
