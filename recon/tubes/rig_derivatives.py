"""Derivatives of the picture position of a point in the water with respect to the parameters of the rig.

The parameters are the refractive index, the lens, the camera and the canister.

A camera ray is determined by its pixel. After refraction into the water, it passes through a point P if

    F1 = P . nu - b_w,    F2 = z_line(P) - P_z          (`recon.optics.refraction`)

are both zero. If a parameter q of the rig changes by dq, the ray of the same pixel misses the point by dF. A
displacement of the point by D = nu dF1 - z dF2 has the same effect (D has no component along the horizontal direction
of the ray). By the implicit function theorem, the picture of the point therefore moves as if the point itself had moved
by D:

    dpx / dq = (dpx / dP) . D / dq

The gradients dpx / dP are provided by every projection. Since F has a closed form, its difference quotient is accurate
to rounding (float64).
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
from rhizotwin.recon.tubes.parameters import Parameter

Array = NDArray[np.float64]

ViewOptics = tuple[View, Optics]


@dataclass(frozen=True, kw_only=True)
class Quantity(Parameter):
    """Parameter of the rig that can be estimated."""

    increase: Callable[[ViewOptics, float], ViewOptics]
    """Function that returns a view and its optics with the parameter increased by a given value."""


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
    """Return a view after a motion of the canister, given as a twist (6,) (rad, mm) in the canister frame.

    A tank around the canister does not move.
    """
    return replace(view, cam_from_canister=view.cam_from_canister @ twist(step))


def move_camera(view: View, step: Array) -> View:
    """Return a view after a motion of the camera.

    ``cam_from_canister`` is multiplied from the left by the motion, which is given as a twist (6,) (rad, mm).
    """
    return view.move_camera(twist(step))


INDEX = Quantity(name="index of the water", step=1e-4, increase=_index)
"""Refractive index of the water. The step is a tenth of the change caused by ten degrees."""
FOCUS = Quantity(name="focal length", step=1e-4, increase=_focus)
"""Relative focal length. The step is 0.01 %, which corresponds to 0.04 px at the edge of a picture."""
CANISTER = tuple(
    Quantity(name=f"canister {what} {'xyz'[k % 3]}", step=step, increase=_canister(k))
    for k, what, step in ((0, "tilt", 1e-5), (1, "tilt", 1e-5), (3, "offset", 1e-3), (4, "offset", 1e-3))
)
"""Pose of the canister relative to the strip: two tilts, rad, and two offsets, mm."""
TURN = Quantity(name="table angle", step=1e-5, increase=_canister(2))
"""Table angle of a single view, rad."""
CAMERA = tuple(
    Quantity(name=f"camera {'turn' if k < 3 else 'shift'} {'xyz'[k % 3]}", step=1e-5 if k < 3 else 1e-3, increase=_camera(k))
    for k in range(6)
)
"""Pose of the camera of a station: three rotations, rad, and three translations, mm."""
SWAY = tuple(Quantity(name=f"sway {what}", step=1e-5, increase=_sway(k)) for k, what in enumerate(("x", "y", "turn")))
"""Sway of the roots in a single view, proportional to depth: displacement along x and along y, in mm per mm of depth,
and rotation about the axis, in rad per mm of depth."""
QUANTITIES = (INDEX, FOCUS, *CANISTER, TURN, *CAMERA)


def miss_distances(view: View, optics: Optics, directions: Array, points_mm: Array) -> Array:
    """Return the horizontal distances F1 and vertical distances F2 (N, 2) by which rays miss points (N, 3), mm.

    Parameters
    ----------
    view, optics : View, Optics
        Camera and canister.
    directions : (N, 3) array
        Directions of the rays, camera frame.
    points_mm : (N, 3) array
        Points, canister frame.

    Returns
    -------
    (N, 2) array
        Distances F1 and F2, mm.
    """
    at = apply_sway(view, optics, points_mm) @ view.azimuth_from_canister[:3, :3].T
    return refraction.miss_distances(optics, refraction.clip_to_water(optics, approach(view, optics, directions)[0]), at)


def normals(view: View, optics: Optics, directions: Array) -> Array:
    """Return horizontal unit vectors (N, 3) perpendicular to the rays in the water, canister frame.

    Each ray is given by its direction (N, 3) in air, camera frame.
    """
    line = refraction.follow(optics, refraction.clip_to_water(optics, approach(view, optics, directions)[0]))
    flat = np.concatenate([line.nu, np.zeros((len(directions), 1))], axis=-1)
    return np.asarray(flat @ view.azimuth_from_canister[:3, :3])


def picture_derivatives(
    view: View, optics: Optics, quantities: tuple[Quantity, ...], px: Array, points_mm: Array, gradient: Array
) -> Array:
    """Return the derivatives (N, Q) of picture positions with respect to parameters of the rig.

    The unit of a derivative is that of ``gradient`` times mm, divided by the unit of the parameter.

    Parameters
    ----------
    px : (N, 2) float64 array
        Positions of the points in the picture, px.
    points_mm : (N, 3) float64 array
        Points, canister frame.
    gradient : (N, 3) float64 array
        Gradient of the picture position (column, row, or position along a direction) with respect to the point.
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
