"""How the picture of a point in the water moves when the rig is a little other than thought.

Index, lens, camera, canister.

A camera ray is fixed by its pixel; followed into the water it passes a point at

    F1 = P . nu - b_w,    F2 = z_line(P) - P_z          (`recon.optics.refraction`: both 0 where it meets the point)

and when a quantity q of the rig changes by dq, the same pixel's ray misses by dF. A shift of the point by D = nu dF1 -
z dF2 makes the ray miss by just as much (D has no part along the ray's horizontal direction). So by the implicit
function theorem the picture of the point moves as if the point itself had moved by D,

    dpx / dq = (dpx / dP) . D / dq,

with the gradients dpx / dP that every projection gives. F is closed form, so that its difference quotient is exact to
rounding (float64).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.calibration.view_fit import twist
from rhizotwin.recon.optics import refraction
from rhizotwin.recon.optics.cameras import View, approach, camera_directions, swayed
from rhizotwin.recon.optics.refraction import Optics

Array = NDArray[np.float64]

Sight = tuple[View, Optics]


@dataclass(frozen=True)
class Quantity:
    """Something of the rig that may be other than thought."""

    name: str
    unit: str
    step: float
    """Step of the difference quotient."""
    changed: Callable[[Sight, float], Sight]
    """A view and its optics when the quantity is larger by some value."""


def _index(sight: Sight, value: float) -> Sight:
    view, optics = sight
    return view, replace(optics, n_water=optics.n_water + value)


def _focus(sight: Sight, value: float) -> Sight:
    view, optics = sight
    return replace(view, camera=view.camera.focused(1.0 + value)), optics


def _canister(axis: int) -> Callable[[Sight, float], Sight]:
    return lambda sight, value: (with_canister_moved(sight[0], value * np.eye(6)[axis]), sight[1])


def _camera(axis: int) -> Callable[[Sight, float], Sight]:
    return lambda sight, value: (displaced(sight[0], value * np.eye(6)[axis]), sight[1])


def _sway(axis: int) -> Callable[[Sight, float], Sight]:
    def changed(sight: Sight, value: float) -> Sight:
        view, optics = sight
        x, y, turn = np.asarray(view.sway) + value * np.eye(3)[axis]
        return replace(view, sway=(float(x), float(y), float(turn))), optics

    return changed


def with_canister_moved(view: View, step: Array) -> View:
    """Return a view whose canister moved by a twist (6,) (rad, mm) in its own frame; a tank does not."""
    return replace(view, cam_from_canister=view.cam_from_canister @ twist(step))


def displaced(view: View, step: Array) -> View:
    """Return a view whose camera moved by a left-hand twist (6,) (rad, mm) of ``cam_from_canister``."""
    return view.moved(twist(step))


INDEX = Quantity("index of the water", "", 1e-4, _index)
"""Of the water; the step is a tenth of what ten degrees change."""
FOCUS = Quantity("focal length", "", 1e-4, _focus)
"""Relative; the step is a hundredth of a per cent, 0.04 px at a picture's edge."""
CANISTER = tuple(
    Quantity(f"canister {what} {'xyz'[k % 3]}", unit, step, _canister(k))
    for k, what, unit, step in ((0, "tilt", "rad", 1e-5), (1, "tilt", "rad", 1e-5), (3, "offset", "mm", 1e-3), (4, "offset", "mm", 1e-3))
)
"""How the canister stands in the strip: tilt and offset."""
TURN = Quantity("table angle", "rad", 1e-5, _canister(2))
"""Angle of the table in one view."""
CAMERA = tuple(
    Quantity(f"camera {'turn' if k < 3 else 'shift'} {'xyz'[k % 3]}", "rad" if k < 3 else "mm", 1e-5 if k < 3 else 1e-3, _camera(k))
    for k in range(6)
)
"""How a station's camera stands."""
SWAY = tuple(Quantity(f"sway {what}", unit, 1e-5, _sway(k)) for k, (what, unit) in enumerate((("x", ""), ("y", ""), ("turn", "rad/mm"))))
"""How far aside what hangs in the water is in one view, for each mm of depth."""
QUANTITIES = (INDEX, FOCUS, *CANISTER, TURN, *CAMERA)


def missed(view: View, optics: Optics, directions: Array, points_mm: Array) -> Array:
    """Return F1 and F2 (N, 2) in mm of rays of directions (N, 3), camera's frame, at points (N, 3), canister frame.

    Parameters
    ----------
    view, optics : View, Optics
        Camera and canister.
    directions : (N, 3) array
        Of the rays, camera's frame.
    points_mm : (N, 3) array
        Canister frame.

    Returns
    -------
    (N, 2) array
        mm.
    """
    at = swayed(view, optics, points_mm) @ view.azimuth_from_canister[:3, :3].T
    line = refraction.follow(optics, refraction.within(optics, approach(view, optics, directions)[0]))
    beside = np.sum(at[:, :2] * line.nu, axis=-1) - line.b_mm
    return np.stack([beside, refraction.height_at(optics, line, at[:, :2]) - at[:, 2]], axis=-1)


def normals(view: View, optics: Optics, directions: Array) -> Array:
    """Return the horizontal normals (N, 3) in the water of rays of directions (N, 3).

    The normals are in the canister's frame, the directions in the camera's.
    """
    line = refraction.follow(optics, refraction.within(optics, approach(view, optics, directions)[0]))
    flat = np.concatenate([line.nu, np.zeros((len(directions), 1))], axis=-1)
    return np.asarray(flat @ view.azimuth_from_canister[:3, :3])


def moves(view: View, optics: Optics, quantities: tuple[Quantity, ...], px: Array, points_mm: Array, gradient: Array) -> Array:
    """Return by how much positions in a picture change with quantities.

    (N, Q), gradient's unit times mm by the quantity's unit.

    Parameters
    ----------
    px : (N, 2) float64 array
        Where the points lie in the picture.
    points_mm : (N, 3) float64 array
        Canister frame.
    gradient : (N, 3) float64 array
        Of the position in the picture (column, row, or along a direction) by the point.
    """
    directions = camera_directions(view.camera, px)

    def at(changed: Sight) -> Array:
        same = changed[0].camera is view.camera
        return missed(*changed, directions if same else camera_directions(changed[0].camera, px), points_mm)

    beside = np.sum(gradient * normals(view, optics, directions), axis=-1)
    found = np.zeros((len(px), len(quantities)))
    for k, quantity in enumerate(quantities):
        above, below = (at(quantity.changed((view, optics), side * quantity.step)) for side in (1.0, -1.0))
        by = (above - below) / (2.0 * quantity.step)
        found[:, k] = beside * by[:, 0] - gradient[:, 2] * by[:, 1]
    return found
