"""Derivatives of the picture position of a point in the water by the parameters of the rig.

The parameters are the refractive index, the lens, the camera and the canister.

A camera ray is fixed by its pixel. Followed into the water, it meets a point if

    F1 = P . nu - b_w,    F2 = z_line(P) - P_z          (`recon.optics.refraction`)

are both zero. When a parameter q of the rig changes by dq, the ray of the same pixel misses the point by dF. A shift of
the point by D = nu dF1 - z dF2 has the same effect (D has no component along the horizontal direction of the ray). By
the implicit function theorem, the picture of the point therefore moves as if the point itself had moved by D,

    dpx / dq = (dpx / dP) . D / dq,

with the gradients dpx / dP that every projection provides. F has a closed form, so that its difference quotient is
accurate to rounding (float64).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.calibration.view_fit import twist
from rhizotwin.recon.optics import refraction
from rhizotwin.recon.optics.cameras import View, apply_sway, approach, camera_directions
from rhizotwin.recon.optics.refraction import Optics

Array = NDArray[np.float64]

ViewOptics = tuple[View, Optics]


@dataclass(frozen=True)
class Quantity:
    """A parameter of the rig."""

    name: str
    unit: str
    step: float
    """Step of the difference quotient."""
    increase: Callable[[ViewOptics, float], ViewOptics]
    """Function that returns a view and its optics with the parameter increased by a value."""


def _index(sight: ViewOptics, value: float) -> ViewOptics:
    view, optics = sight
    return view, replace(optics, n_water=optics.n_water + value)


def _focus(sight: ViewOptics, value: float) -> ViewOptics:
    view, optics = sight
    return replace(view, camera=view.camera.focused(1.0 + value)), optics


def _canister(axis: int) -> Callable[[ViewOptics, float], ViewOptics]:
    return lambda sight, value: (move_canister(sight[0], value * np.eye(6)[axis]), sight[1])


def _camera(axis: int) -> Callable[[ViewOptics, float], ViewOptics]:
    return lambda sight, value: (move_camera(sight[0], value * np.eye(6)[axis]), sight[1])


def _sway(axis: int) -> Callable[[ViewOptics, float], ViewOptics]:
    def increase(sight: ViewOptics, value: float) -> ViewOptics:
        view, optics = sight
        x, y, turn = np.asarray(view.sway) + value * np.eye(3)[axis]
        return replace(view, sway=(float(x), float(y), float(turn))), optics

    return increase


def move_canister(view: View, step: Array) -> View:
    """Return a view whose canister moved by a twist (6,) (rad, mm) in its own frame; a tank does not move."""
    return replace(view, cam_from_canister=view.cam_from_canister @ twist(step))


def move_camera(view: View, step: Array) -> View:
    """Return a view whose camera moved by a left-hand twist (6,) (rad, mm) of ``cam_from_canister``."""
    return view.move_camera(twist(step))


INDEX = Quantity("index of the water", "", 1e-4, _index)
"""Refractive index of the water; the step is a tenth of the effect of ten degrees."""
FOCUS = Quantity("focal length", "", 1e-4, _focus)
"""Relative; the step is a hundredth of a per cent, 0.04 px at a picture's edge."""
CANISTER = tuple(
    Quantity(f"canister {what} {'xyz'[k % 3]}", unit, step, _canister(k))
    for k, what, unit, step in ((0, "tilt", "rad", 1e-5), (1, "tilt", "rad", 1e-5), (3, "offset", "mm", 1e-3), (4, "offset", "mm", 1e-3))
)
"""Pose of the canister in the strip: tilt and offset."""
TURN = Quantity("table angle", "rad", 1e-5, _canister(2))
"""Table angle of one view."""
CAMERA = tuple(
    Quantity(f"camera {'turn' if k < 3 else 'shift'} {'xyz'[k % 3]}", "rad" if k < 3 else "mm", 1e-5 if k < 3 else 1e-3, _camera(k))
    for k in range(6)
)
"""Pose of a station's camera."""
SWAY = tuple(Quantity(f"sway {what}", unit, 1e-5, _sway(k)) for k, (what, unit) in enumerate((("x", ""), ("y", ""), ("turn", "rad/mm"))))
"""Lateral displacement of the roots in one view, per mm of depth."""
QUANTITIES = (INDEX, FOCUS, *CANISTER, TURN, *CAMERA)


def miss_distances(view: View, optics: Optics, directions: Array, points_mm: Array) -> Array:
    """Return the distances F1 and F2 (N, 2), mm, by which rays of directions (N, 3) miss points (N, 3).

    Parameters
    ----------
    view, optics : View, Optics
        Camera and canister.
    directions : (N, 3) array
        Directions of the rays, camera's frame.
    points_mm : (N, 3) array
        Points, canister frame.

    Returns
    -------
    (N, 2) array
        mm.
    """
    at = apply_sway(view, optics, points_mm) @ view.azimuth_from_canister[:3, :3].T
    line = refraction.follow(optics, refraction.clip_to_water(optics, approach(view, optics, directions)[0]))
    beside = np.sum(at[:, :2] * line.nu, axis=-1) - line.b_mm
    return np.stack([beside, refraction.height_at(optics, line, at[:, :2]) - at[:, 2]], axis=-1)


def normals(view: View, optics: Optics, directions: Array) -> Array:
    """Return the horizontal normals (N, 3) in the water of rays of directions (N, 3).

    The normals are in the canister's frame, the directions in the camera's.
    """
    line = refraction.follow(optics, refraction.clip_to_water(optics, approach(view, optics, directions)[0]))
    flat = np.concatenate([line.nu, np.zeros((len(directions), 1))], axis=-1)
    return np.asarray(flat @ view.azimuth_from_canister[:3, :3])


def picture_derivatives(
    view: View, optics: Optics, quantities: tuple[Quantity, ...], px: Array, points_mm: Array, gradient: Array
) -> Array:
    """Return the derivatives of positions in a picture by parameters of the rig.

    The shape is (N, Q); the unit is that of ``gradient`` times mm per unit of the parameter.

    Parameters
    ----------
    px : (N, 2) float64 array
        Positions of the points in the picture.
    points_mm : (N, 3) float64 array
        Points, canister frame.
    gradient : (N, 3) float64 array
        Gradient of the position in the picture (column, row, or along a direction) by the point.
    """
    directions = camera_directions(view.camera, px)

    def at(changed: ViewOptics) -> Array:
        same = changed[0].camera is view.camera
        return miss_distances(*changed, directions if same else camera_directions(changed[0].camera, px), points_mm)

    beside = np.sum(gradient * normals(view, optics, directions), axis=-1)
    found = np.zeros((len(px), len(quantities)))
    for k, quantity in enumerate(quantities):
        above, below = (at(quantity.increase((view, optics), side * quantity.step)) for side in (1.0, -1.0))
        by = (above - below) / (2.0 * quantity.step)
        found[:, k] = beside * by[:, 0] - gradient[:, 2] * by[:, 1]
    return found
