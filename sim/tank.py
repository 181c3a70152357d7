"""Tank of liquid around the canister.

It consists of four meshes that are fixed in the rig while the canister rotates.
"""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from rhizotwin.scenes import frames
from rhizotwin.scenes.model import Scene, Tank

Array = NDArray[np.float64]
Faces = NDArray[np.int64]

OUTSIDE, INSIDE, SURFACE, OPAQUE = "tank_outside", "tank_inside", "tank_surface", "tank_opaque"
"""Names of the meshes of the tank in the Mitsuba scene."""
HOLE_SIDES = 720
"""Number of sides of the hole in the liquid's surface in which the canister stands. The sides deviate by at most 1 um
from a circle with a radius of 76 mm."""


def _wall_mesh(tank: Tank, inset_mm: float, low_mm: float) -> tuple[Array, Faces]:
    """Return vertices (8, 3), mm, and faces (F, 3) of the four vertical walls of a box, with outward normals."""
    x, y = tank.front_mm - inset_mm, tank.half_width_mm - inset_mm
    ring = np.array([[x, -y], [x, y], [-x, y], [-x, -y]])
    vertices = np.concatenate([np.column_stack([ring, np.full(4, z)]) for z in (low_mm, tank.level_mm)])
    faces = [[k, (k + 1) % 4, (k + 1) % 4 + 4] for k in range(4)] + [[k, (k + 1) % 4 + 4, k + 4] for k in range(4)]
    return vertices, np.array(faces)


def _opaque_mesh(tank: Tank, low_mm: float) -> tuple[Array, Faces]:
    """Return the vertices (V, 3), mm, and faces (F, 3) of the upper edges of the tank's walls, and of its bottom."""
    outer, inner = _wall_mesh(tank, 0.0, low_mm)[0], _wall_mesh(tank, tank.wall_mm, low_mm)[0]
    vertices = np.concatenate([outer[4:], inner[4:], outer[:4]])
    rim = [[k, (k + 1) % 4, (k + 1) % 4 + 4] for k in range(4)] + [[k, (k + 1) % 4 + 4, k + 4] for k in range(4)]
    return vertices, np.array([*rim, [8, 9, 10], [8, 10, 11]])


def _surface_mesh(tank: Tank, hole: Array) -> tuple[Array, Faces]:
    """Return the vertices (V, 3), mm, and faces (F, 3) of the liquid's surface around the canister.

    The outline of the canister on this surface is ``hole`` (N, 2), mm, counter-clockwise as seen from above.
    """
    x, y = tank.front_mm - tank.wall_mm, tank.half_width_mm - tank.wall_mm
    out = hole / np.maximum(np.abs(hole[:, :1]) / x, np.abs(hole[:, 1:]) / y)  # extended radially from the axis to the walls
    corners = np.array([[x, y], [-x, y], [-x, -y], [x, -y]])
    count = len(hole)
    vertices = np.column_stack([np.concatenate([hole, out, corners]), np.full(2 * count + 4, tank.level_mm)])
    k = np.arange(count)
    after = (k + 1) % count
    faces = [np.stack([k, k + count, after + count], axis=1), np.stack([k, after + count, after], axis=1)]
    on_x = np.abs(np.abs(out[:, 0]) - x) < 1e-9
    turns = np.flatnonzero(on_x != on_x[after])  # a corner of the tank is missing after each of these points
    for number in turns:
        corner = int(np.argmin(np.linalg.norm(corners - out[number], axis=1)))
        faces.append(np.array([[number + count, 2 * count + corner, after[number] + count]]))
    return vertices, np.concatenate(faces)


def meshes(scene: Scene, tank: Tank) -> dict[str, tuple[Array, Faces, dict[str, Any]]]:
    """Return the meshes of the tank, keyed by name.

    Each mesh consists of vertices (V, 3) in the tank frame, mm, faces (F, 3) and a Mitsuba material.
    """
    low = -scene.canister.height_mm
    turn = 2.0 * np.pi * np.arange(HOLE_SIDES) / HOLE_SIDES
    hole = scene.canister.outer_radius_mm * np.column_stack([np.cos(turn), np.sin(turn)])
    glass = {"type": "dielectric", "int_ior": tank.n_wall, "ext_ior": 1.0}
    wet = {"type": "dielectric", "int_ior": tank.n_liquid, "ext_ior": tank.n_wall}
    level = {"type": "dielectric", "int_ior": tank.n_liquid, "ext_ior": 1.0}
    return {
        OUTSIDE: (*_wall_mesh(tank, 0.0, low), glass),
        INSIDE: (*_wall_mesh(tank, tank.wall_mm, low), wet),
        SURFACE: (*_surface_mesh(tank, hole), level),
        OPAQUE: (*_opaque_mesh(tank, low), {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": 0.02}}),
    }


def place(built: mi.Scene, scene: Scene, rig_from_canister: Array, *, radius_mm: float) -> None:
    """Move the tank to its position in the canister frame of a view.

    The hole in the liquid's surface moves with the canister.

    Parameters
    ----------
    built : mitsuba.Scene
        Mitsuba scene with the tank.
    scene : Scene
        Scene with the rig.
    rig_from_canister : (4, 4) float64
        Pose of the canister in the view.
    radius_mm : float
        Outer radius of the true canister, mm.
    """
    if scene.tank is None:
        return
    canister_from_rig = frames.invert(rig_from_canister)
    turn = 2.0 * np.pi * np.arange(HOLE_SIDES) / HOLE_SIDES
    # intersection of the canister's wall, which may be tilted, with the surface
    circle = np.column_stack([radius_mm * np.cos(turn), radius_mm * np.sin(turn), np.full(HOLE_SIDES, scene.tank.level_mm)])
    axis = rig_from_canister[:3, 2]
    here = frames.apply(rig_from_canister, circle)
    hole = here + ((scene.tank.level_mm - here[:, 2]) / axis[2])[:, None] * axis
    parameters = mi.traverse(built)
    rig_from_tank = frames.rotation_z(np.deg2rad(scene.tank.turn_deg))
    canister_from_tank = canister_from_rig @ rig_from_tank
    for name, (vertices, _, _) in meshes(scene, scene.tank).items():
        moved = _surface_mesh(scene.tank, frames.apply(frames.invert(rig_from_tank), hole)[:, :2])[0] if name == SURFACE else vertices
        parameters[f"{name}.vertex_positions"] = np.ascontiguousarray(frames.apply(canister_from_tank, moved), dtype=np.float32).ravel()
    parameters.update()
