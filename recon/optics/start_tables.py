"""Start tables: initial values for Newton's method, and distances to points that do not have exactly one image.

A fan of lines of sight with the same vertical component is swept over the canister's cross-section. The number of lines
through a point is the number of its images, and the adjacent lines of the fan yield the initial ray.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy import ndimage

from rhizotwin.recon.optics import refraction, tank
from rhizotwin.recon.optics.cameras import View, tank_view
from rhizotwin.recon.optics.refraction import Array, Optics, WaterLine
from rhizotwin.recon.optics.tank import TankView

CELL_MM = 1.0
"""Cell size of the start tables, mm. Newton's method refines the interpolated values."""
ALL_CLEAR_MM = 1e3
"""Distance to points that do not have exactly one image, if there are none, mm. It exceeds every canister."""
_SINES = np.sin(np.linspace(-np.pi / 2, np.pi / 2, 193))
"""Impact parameters of the lines in a fan, as fractions of the largest impact parameter. Neighbouring lines are at most
half a cell apart, and closest together where refraction is strongest."""
_NAMES = np.linspace(-0.9, 0.9, 4001)
"""Values of the ray component q_y at which impact parameters are computed, so that the lines of a fan can be chosen by
interpolation. The range exceeds that of rays through a tank's front (64 degrees to either side)."""


@lru_cache(maxsize=128)
def direct_table(rho_mm: float, z_cam_mm: float, optics: Optics) -> Array:
    """Compute the start table of a camera without a tank. The latest tables are kept.

    Parameters
    ----------
    rho_mm, z_cam_mm : float
        Horizontal distance of the camera from the axis, and height of the camera in the canister frame, mm.
    optics : Optics
        Optics of the canister.

    Returns
    -------
    (ny, nx, 2) float64 array
        Initial value (impact parameter in air, mm), and horizontal distance to the nearest point at which the view is
        blind or shows two images, mm, over positions in the azimuth frame. Rows are |y| from -1 mm, because y < 0
        mirrors y > 0.
    """
    reach = rho_mm - optics.outer_radius_mm
    steepest = max(abs(optics.water_z_mm - z_cam_mm), abs(optics.floor_z_mm - z_cam_mm))
    p_max = float(np.sin(np.arctan2(steepest, reach)))
    b_a, count = _round_fan(optics, rho_mm, 0.5 * p_max)
    single = count == 1
    for p_z in (0.0, p_max):
        single &= _round_fan(optics, rho_mm, p_z)[1] == 1
    if optics.straight:
        single[:] = True
    whole = np.concatenate([single[:1:-1], single[1:]])  # y < 0 mirrors y > 0
    clear_mm = np.full(whole.shape, ALL_CLEAR_MM) if whole.all() else ndimage.distance_transform_edt(whole) * CELL_MM
    clear_mm = clear_mm[len(single) - 3 :]
    return np.stack([b_a, clear_mm], axis=-1)


def tank_table(view: View, optics: Optics) -> Array:
    """Compute the start table of a view through a tank.

    Returns
    -------
    (ny, nx, 2) float64 array
        Initial value (q_y), and horizontal distance to the nearest point at which the view is blind or shows two
        images, mm, over positions in the azimuth frame.
    """
    at = tank_view(view, optics)
    reach = float(at.centre_mm[0]) - at.tank.front_mm
    climbs = [float(np.sin(np.arctan2(z - view.centre_mm[2], reach + at.tank.front_mm))) for z in (optics.water_z_mm, optics.floor_z_mm)]
    q_y, count = _tank_fan(at, 0.5 * sum(climbs))
    single = count == 1
    for q_z in climbs:
        single &= _tank_fan(at, q_z)[1] == 1
    single |= np.hypot(*np.moveaxis(_positions(optics), -1, 0)) >= optics.inner_radius_mm  # there are no roots
    clear_mm = np.full(single.shape, ALL_CLEAR_MM) if single.all() else ndimage.distance_transform_edt(single) * CELL_MM
    return np.stack([q_y, clear_mm], axis=-1)


def _positions(optics: Optics, *, low_mm: float | None = None) -> Array:
    """Return the positions (ny, nx, 2) of the table's cells, mm.

    The positions cover the cross-section of the canister, starting at y = ``low_mm``.
    """
    most = np.ceil(optics.inner_radius_mm) + 1.0
    y = np.arange(-most if low_mm is None else low_mm, most + 1.0, CELL_MM)
    return np.stack(np.meshgrid(np.arange(-most, most + 1.0, CELL_MM), y), axis=-1)


def _round_fan(optics: Optics, rho_mm: float, p_z: float) -> tuple[Array, Array]:
    """Tabulate the impact parameter b_a, mm, and the number of images of points, for rays with the same p_z.

    The tables cover positions (x, y) with y >= -1 mm.
    """
    b_mm = _SINES * optics.w_limit * optics.outer_radius_mm
    line = refraction.follow(optics, refraction.from_point(rho_mm, 0.0, b_mm, np.full_like(b_mm, p_z)))
    return _sweep(_positions(optics, low_mm=-1.0), line, b_mm)


def _tank_fan(at: TankView, q_z: float) -> tuple[Array, Array]:
    """Tabulate q_y and the number of images of points at positions (x, y), for rays with the same q_z."""
    wide = tank.approach(at, _NAMES, np.full_like(_NAMES, q_z))[0]
    q_y = np.interp(_SINES, wide.b_mm / refraction.reach_mm(at.optics, wide.p_z), _NAMES)
    line = refraction.clip_to_water(at.optics, tank.approach(at, q_y, np.full_like(q_y, q_z))[0])
    return _sweep(_positions(at.optics), refraction.follow(at.optics, line), q_y)


def _sweep(at: Array, line: WaterLine, name: Array) -> tuple[Array, Array]:
    """Count the lines (K,) of a fan through each position (ny, nx, 2), and interpolate a parameter of the lines.

    Returns
    -------
    found : (ny, nx) float64 array
        Parameter ``name`` of the line through each position, interpolated; that of the last line if there are several.
    count : (ny, nx) float64 array
        Number of lines through each position.
    """
    count = np.zeros(at.shape[:2])
    found = np.zeros(at.shape[:2])
    nu = line.nu
    f_last = at @ nu[0] - line.b_mm[0]
    for k in range(1, len(name)):
        f = at @ nu[k] - line.b_mm[k]
        crossing = np.signbit(f) != np.signbit(f_last)
        before, after = f_last[crossing], f[crossing]
        found[crossing] = name[k - 1] + (name[k] - name[k - 1]) * before / (before - after)
        count[crossing] += 1.0
        f_last = f
    return found, count
