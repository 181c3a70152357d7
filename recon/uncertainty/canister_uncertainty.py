"""Uncertainty of the volume due to tolerances of the canister and the tank.

The dimensions and refractive indices of a purchased canister differ from its drawing. If pictures were taken through
one canister, and are reconstructed with another one, each point is displaced to the position that agrees best with all
views. The displacement is computed with one Gauss-Newton step, since it is small. It changes the volume of a small cube
at the point by a factor that is the determinant of the map's derivatives. The mean of this factor over the shape gives
the relative error of the volume.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.calibration.canister_pose import CanisterPose
from rhizotwin.recon.hull.leaves import Leaves
from rhizotwin.recon.optics.cameras import View, project_inner, tank_pose
from rhizotwin.recon.optics.refraction import Optics
from rhizotwin.recon.uncertainty.budget import NINETY, Term
from rhizotwin.scenes.frames import from_rotvec, rotation_z
from rhizotwin.scenes.model import Tank

Array = NDArray[np.float64]

WALL, N_WALL, RADIUS = 0.1, 0.002, 0.01
"""Tolerances of cast acrylic tube: relative tolerance of the wall thickness, tolerance of the refractive index (1.489
to 1.493), and relative tolerance of the radius."""
EVENLY = 0.9
"""Fraction of the distance from the middle to the limits that contains a uniformly distributed quantity with a
probability of 90 %."""
EDGES = 0.001
"""Relative accuracy of the radius if it is measured from the canister's edges in the pictures. In a test, an excess of
0.300 mm was measured as 0.323 mm."""
TANK_WALL, TANK_FRONT_MM, LIQUID, TURN_DEG, LEAN_DEG = 0.1, 1.0, 0.001, 2.0, 0.3
"""Tolerances of a tank: relative thickness of acrylic sheet, position of the front measured with a ruler (mm),
refractive index of its water, rotation set by eye (standard deviation, deg), and tilt of the front (deg). The index
varies within ten degrees and one gram of salts per litre. The tilt is that of a front that is glued at a right angle to
within half a millimetre over 100 mm, and set with a level."""
POINTS, VIEWS = 100, 12
"""Number of points of the shape, and number of views, for which the displacements are computed. Small numbers are
sufficient, since the displacement varies smoothly."""
CUBE_MM = 1.0
"""Edge length of the cubes whose change of volume is computed, mm. It is far smaller than the distances over which the
displacement varies."""
STEP_MM = 1e-3
"""Step of the difference quotients of pixel positions with respect to a point, mm. In double precision, they are
accurate to 1e-6."""


def canister_term(views: Sequence[View], optics: Optics, leaves: Leaves, volume_mm3: float, *, edges: CanisterPose | None) -> Term:
    """Return the term of the error budget for a canister, and a tank, that differ from their drawing.

    Parameters
    ----------
    views : sequence of View
        Views of the scan.
    optics : Optics
        The canister as drawn.
    leaves : Leaves
        The shape.
    volume_mm3 : float
        Volume of the shape.
    edges : CanisterPose or None
        Pose from the canister's edges; None if they were not visible.
    """
    o, radius_excess_mm = optics, None if edges is None else edges.radius_excess_mm
    wall_mm = o.outer_radius_mm - o.inner_radius_mm
    off_mm = RADIUS * EVENLY * o.outer_radius_mm if radius_excess_mm is None else abs(radius_excess_mm) + EDGES * o.outer_radius_mm
    sign = -1.0 if radius_excess_mm is not None and radius_excess_mm < 0.0 else 1.0
    others = {
        "its wall": replace(o, inner_radius_mm=o.inner_radius_mm - EVENLY * WALL * wall_mm),
        "the index of its wall": replace(o, n_wall=o.n_wall + EVENLY * N_WALL),
        "its radius": replace(o, outer_radius_mm=o.outer_radius_mm + sign * off_mm, inner_radius_mm=o.inner_radius_mm + sign * off_mm),
    }
    others |= {} if o.tank is None else _tank_tolerances(o, o.tank)
    points = _points(leaves)
    shares = {name: abs(misread(views, o, other, points)) for name, other in others.items()}
    if o.tank is not None:
        sigma_deg = TURN_DEG if edges is None else edges.tank_sigma_deg
        moved = {"the rotation of its tank": rotation_z(np.deg2rad(NINETY * sigma_deg))}
        moved["the tilt of its tank"] = from_rotvec(np.deg2rad([0.0, EVENLY * LEAN_DEG, 0.0]), np.zeros(3))
        for name, turn in moved.items():
            others_seen = [replace(view, cam_from_tank=tank_pose(view) @ turn) for view in views]
            shares[name] = abs(misread(views, o, o, points, others_seen))
    half = math.hypot(*shares.values()) * volume_mm3
    worst = max(shares, key=lambda name: shares[name])
    return Term.symmetric("canister", half, f"the canister may differ from its drawing, mainly in {worst}")


def _tank_tolerances(o: Optics, tank: Tank) -> dict[str, Optics]:
    """Return the optics of a tank with each of its dimensions changed to the limit of its tolerance.

    The optics are keyed by the description of what is changed.
    """
    changed = {
        "the walls of its tank": replace(tank, wall_mm=tank.wall_mm * (1.0 + EVENLY * TANK_WALL)),
        "the position of its tank": replace(tank, front_mm=tank.front_mm + EVENLY * TANK_FRONT_MM),
        "the liquid of its tank": replace(tank, n_liquid=tank.n_liquid + EVENLY * LIQUID),
    }
    return {name: replace(o, tank=other) for name, other in changed.items()}


def misread(views: Sequence[View], believed: Optics, true: Optics, points_mm: Array, true_views: Sequence[View] | None = None) -> float:
    """Return the relative error of a volume that is reconstructed with the wrong canister.

    The error is positive if the reconstructed volume is too large.

    Parameters
    ----------
    views : sequence of View
        Views of the scan in any order, of which `VIEWS` are used, evenly spaced around the turn.
    believed, true : Optics
        Assumed and actual optics.
    points_mm : (N, 3) float64
        Points of the volume, canister frame.
    true_views : sequence of View, optional
        Actual views, if they differ.
    """
    pairs = list(zip(views, views if true_views is None else true_views, strict=True))
    around = np.argsort([np.arctan2(view.centre_mm[1], view.centre_mm[0]) for view in views])
    some = [pairs[k] for k in around[np.linspace(0, len(pairs), min(VIEWS, len(pairs)), endpoint=False).astype(int)]]
    corners = np.concatenate([points_mm + 0.5 * side * CUBE_MM * np.eye(3)[axis] for axis in range(3) for side in (-1.0, 1.0)])
    found = corners + _shifts(some, believed, true, corners)
    ends = found.reshape(3, 2, len(points_mm), 3)
    edges = ((ends[:, 1] - ends[:, 0]) / CUBE_MM).transpose(1, 0, 2)
    valid = np.isfinite(edges).all(axis=(1, 2))
    return float(np.linalg.det(edges[valid]).mean() - 1.0) if valid.any() else 0.0


def _shifts(views: Sequence[tuple[View, View]], believed: Optics, true: Optics, points_mm: Array) -> Array:
    """Return the displacements (N, 3) of points that are reconstructed with the assumed optics.

    The pictures are taken through the true optics. A displacement is NaN if fewer than three views show the point.
    """
    count = len(points_mm)
    normal, side, votes = np.zeros((count, 3, 3)), np.zeros((count, 3)), np.zeros(count, int)
    steps_mm = np.concatenate([points_mm, *(points_mm + STEP_MM * axis for axis in np.eye(3))])
    for view, true_view in views:
        here, *ahead = project_inner(view, believed, steps_mm).reshape(4, count, 2)
        gradient = np.stack([(px - here) / STEP_MM for px in ahead], axis=-1)  # (N, 2, 3)
        away = project_inner(true_view, true, points_mm) - here
        visible = np.isfinite(gradient).all(axis=(1, 2)) & np.isfinite(away).all(axis=1)
        normal[visible] += np.einsum("nki,nkj->nij", gradient[visible], gradient[visible])
        side[visible] += np.einsum("nki,nk->ni", gradient[visible], away[visible])
        votes += visible
    shift, enough = np.full((count, 3), np.nan), votes >= 3
    shift[enough] = np.linalg.solve(normal[enough], side[enough][:, :, None])[:, :, 0]
    return shift


def _points(leaves: Leaves) -> Array:
    """Return points (N, 3) in the shape that are uniformly distributed over its volume."""
    weight = np.cumsum(leaves.filled_volume)
    return leaves.select(np.searchsorted(weight, (np.arange(POINTS) + 0.5) / POINTS * weight[-1])).middles_mm
