"""Place a specimen that was read from a file.

The specimen has the position given in the file, is transformed as specified in the scene, or is placed below the grid
of the net pot.
"""

from dataclasses import dataclass, replace
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.rsml import Root
from rhizotwin.scenes.specimens import PlacedFile

Array = NDArray[np.float64]

TOUCH_MM = 1e-6
"""Maximum distance of a point beyond the wall, the floor or the water's surface, mm. It allows for rounding errors."""
FREE_MM = 0.5
"""Distance between the grid and a specimen that is placed automatically, mm. It is the same for grown roots
(`GrownSpecimen`)."""
_UPSIDE_DOWN = np.diag([1.0, -1.0, -1.0])
"""Rotation by 180 degrees about the x axis."""
_UPRIGHT = {
    "x": np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]),  # (x, y, z) -> (-z, y, x)
    "y": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]),  # (x, y, z) -> (x, -z, y)
    "z": np.eye(3),
}
"""Rotation that makes an axis of the file vertical."""


@dataclass(frozen=True)
class Placement:
    """Similarity transform: p -> scale * turn * p + shift."""

    turn: Array
    """Rotation matrix (3, 3)."""
    scale: float
    """Scale factor."""
    shift_mm: Array
    """Translation (3,), mm."""

    def of(self, points_mm: Array) -> Array:
        """Transform points (N, 3), mm."""
        placed: Array = self.scale * points_mm @ self.turn.T + self.shift_mm
        return placed

    def roots(self, roots: tuple[Root, ...]) -> tuple[Root, ...]:
        """Transform centre lines and diameters of roots."""
        return tuple(replace(root, points_mm=self.of(root.points_mm), diameters_mm=self.scale * root.diameters_mm) for root in roots)


def find_placement(
    specimen: PlacedFile,
    points_mm: Array,
    scene: Scene,
    *,
    growth_mm: Array | None = None,
    vertical_axis: Literal["x", "y", "z"] | None = None,
) -> Placement:
    """Compute the placement of a specimen.

    Parameters
    ----------
    specimen : PlacedFile
        Specimen with its placement options.
    points_mm : (N, 3) float64
        Points of the specimen's surface, mm, in the frame of the file.
    scene : Scene
        Scene with the net pot.
    growth_mm : (3,) float64 or None
        Vector from the base of the main root to its centre, which points down (`traced_roots.growth_direction`). None:
        unknown, for meshes.
    vertical_axis : {"x", "y", "z"} or None
        Axis of the file along which the depth is measured. None: z or, with ``place = "auto"``, y if z is constant.

    Returns
    -------
    Placement
        Placement of the specimen. With ``place = "auto"``, flat traced roots (constant z) are rotated upright, and
        roots whose main root grows upwards are turned upside down. The highest point is `FREE_MM` below the grid, and
        the smallest enclosing circle, seen from above, is centred on the axis.
    """
    shift = np.array(specimen.shift_mm)
    is_auto = specimen.place == "auto"
    axis = vertical_axis or ("y" if is_auto and growth_mm is not None and _is_flat(points_mm) else "z")
    turn = (_UPSIDE_DOWN if specimen.flip else np.eye(3)) @ _UPRIGHT[axis]
    if not is_auto:
        return Placement(turn, specimen.scale, shift)
    if growth_mm is not None and float((turn @ growth_mm)[2]) > 0.0 and not specimen.flip:
        turn = _UPSIDE_DOWN @ turn
    turned = points_mm @ turn.T
    return Placement(turn, specimen.scale, translation_below_grid(specimen.scale * turned, scene) + shift)


def _is_flat(points_mm: Array) -> bool:
    """Return whether points (N, 3) lie almost in a horizontal plane.

    Their extent in z must be below a fifth of the larger extent in x and y.
    """
    wide = float(np.ptp(points_mm[:, :2], axis=0).max())
    return float(np.ptp(points_mm[:, 2])) < 0.2 * wide


def translation_below_grid(points_mm: Array, scene: Scene) -> Array:
    """Return the translation (3,), mm, that moves points (N, 3) below the grid and centres them on the axis."""
    (x, y), _ = _enclosing_circle(points_mm)
    return np.array([-x, -y, scene.net_pot.grid_z_mm - FREE_MM - float(points_mm[:, 2].max())])


def maximum_scale(points_mm: Array, scene: Scene) -> float:
    """Return the maximum scale factor at which points (N, 3) fit below the grid, rounded down to three digits."""
    height_mm = scene.net_pot.grid_z_mm - FREE_MM - scene.canister.floor_z_mm
    most = min(
        scene.canister.inner_radius_mm / max(_enclosing_circle(points_mm)[1], 1e-12), height_mm / max(float(np.ptp(points_mm[:, 2])), 1e-12)
    )
    digit = 10.0 ** (np.floor(np.log10(most)) - 2)
    return float(np.floor(most / digit * (1.0 - 1e-9)) * digit)


def _enclosing_circle(points_mm: Array) -> tuple[tuple[float, float], float]:
    """Return the centre and radius, mm, of the smallest circle that encloses points (N, 3) as seen from above."""
    (x, y), _ = cv2.minEnclosingCircle(np.ascontiguousarray(points_mm[:, None, :2], np.float32))
    return (float(x), float(y)), float(np.hypot(points_mm[:, 0] - x, points_mm[:, 1] - y).max())


def check_in_water(points_mm: Array, scene: Scene, *, what: str) -> None:
    """Raise an error if points (N, 3) lie outside the water.

    The points are in mm in the canister frame. The water is limited by the inner wall, the floor and the water's
    surface.

    Parameters
    ----------
    points_mm : (N, 3) array
        Points of the object's surface.
    scene : Scene
        Scene with canister, net pot and water.
    what : str
        Name of the object for the error message.

    Raises
    ------
    UserError
        With the violated limit, distance and position, the limits of the water, and a placement that fits.
    """
    canister = scene.canister
    radius_mm = np.hypot(points_mm[:, 0], points_mm[:, 1])
    past = {
        f"past the inner wall (radius {canister.inner_radius_mm:g} mm)": radius_mm - canister.inner_radius_mm,
        f"below the floor (z {canister.floor_z_mm:g} mm)": canister.floor_z_mm - points_mm[:, 2],
        f"above the water's surface (z {scene.water.level_mm:g} mm)": points_mm[:, 2] - scene.water.level_mm,
    }
    where, distances_mm = max(past.items(), key=lambda item: float(item[1].max()))
    worst = int(np.argmax(distances_mm))
    if distances_mm[worst] > TOUCH_MM:
        x, y, z = points_mm[worst]
        raise UserError(
            f"{what} extends {distances_mm[worst]:.2f} mm {where} at ({x:.1f}, {y:.1f}, {z:.1f}) mm; "
            f"the specimen has a size of {format_size(points_mm)} mm, and the water is limited by "
            f"radius {canister.inner_radius_mm:g} and z {canister.floor_z_mm:g} to {scene.water.level_mm:g} mm. {_advice(points_mm, scene)}"
        )


def format_size(points_mm: Array) -> str:
    """Format the extent of points (N, 3) along x, y and z as text, mm."""
    return " x ".join(f"{value:.3g}" for value in np.ptp(points_mm, axis=0))


def _advice(points_mm: Array, scene: Scene) -> str:
    """Return a placement that fits; factor and shift are relative to the given points (N, 3)."""
    most = maximum_scale(points_mm, scene)
    if most >= 1.0:
        x, y, z = translation_below_grid(points_mm, scene)
        return f"Move it below the grid with --shift-mm={x:.1f},{y:.1f},{z:.1f} (relative to its present position) or --place auto."
    x, y, z = translation_below_grid(most * points_mm, scene)
    return (
        f"Reduce it with --scale {most:g} --shift-mm={x:.1f},{y:.1f},{z:.1f} (relative to its present size and position) "
        f"or --scale {most:g} --place auto, or check the unit of the file."
    )
