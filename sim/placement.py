"""Placement of a specimen from a file: as in the file, as specified, or below the net pot's grid."""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.rsml import Root
from rhizotwin.scenes.specimens import PlacedFile

Array = NDArray[np.float64]

TOUCH_MM = 1e-6
"""Tolerance for specimens beyond wall, floor or surface, for rounding errors."""
FREE_MM = 0.5
"""Distance between an automatically placed specimen and the grid, as for grown roots (`GrownSpecimen`)."""
_UPSIDE_DOWN = np.array([1.0, -1.0, -1.0])
"""Rotation by half a turn about x, which preserves lengths, volumes and handedness."""


@dataclass(frozen=True)
class Placement:
    """A similarity transform: p -> scale * turn * p + shift."""

    turn: Array
    """(3, 3) rotation."""
    scale: float
    shift_mm: Array
    """(3,) translation."""

    def of(self, points_mm: Array) -> Array:
        """Return transformed points (N, 3)."""
        placed: Array = self.scale * points_mm @ self.turn.T + self.shift_mm
        return placed

    def roots(self, roots: tuple[Root, ...]) -> tuple[Root, ...]:
        """Return transformed roots."""
        return tuple(replace(root, points_mm=self.of(root.points_mm), diameters_mm=self.scale * root.diameters_mm) for root in roots)


def find_placement(specimen: PlacedFile, points_mm: Array, scene: Scene, *, base_mm: Array | None = None) -> Placement:
    """Compute the placement of a specimen.

    Parameters
    ----------
    specimen : PlacedFile
        Specimen with its placement options.
    points_mm : (N, 3) float64
        Points of its surface in the file's frame, in mm.
    scene : Scene
        Scene with the grid and the axis.
    base_mm : (M, 3) float64 or None
        Bases of its root axes, which determine the upward direction; None if unknown.

    Returns
    -------
    Placement
        With ``place = "auto"``, flat traced roots (constant z) are rotated upright, with their y pointing down; roots
        with the base below the centre are turned over. The highest point is `FREE_MM` below the grid; the smallest
        enclosing circle is centred on the axis.
    """
    shift = np.array(specimen.shift_mm)
    turn = np.diag(_UPSIDE_DOWN) if specimen.flip else np.eye(3)
    if specimen.place == "given":
        return Placement(turn, specimen.scale, shift)
    if base_mm is not None and _is_flat(points_mm):
        turn = turn @ np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])  # (x, y, z) -> (x, z, -y)
    turned = points_mm @ turn.T
    if base_mm is not None and float(np.mean(base_mm @ turn.T, axis=0)[2]) < float(turned[:, 2].mean()) and not specimen.flip:
        turn = np.diag(_UPSIDE_DOWN) @ turn
        turned = points_mm @ turn.T
    return Placement(turn, specimen.scale, translation_below_grid(specimen.scale * turned, scene) + shift)


def _is_flat(points_mm: Array) -> bool:
    """Return whether points lie in a horizontal plane within the thickness of roots: much wider than high."""
    wide = float(np.ptp(points_mm[:, :2], axis=0).max())
    return float(np.ptp(points_mm[:, 2])) < 0.2 * wide


def translation_below_grid(points_mm: Array, scene: Scene) -> Array:
    """Return the translation (3,) that places points (N, 3) below the grid, centred on the axis."""
    (x, y), _ = _circle(points_mm)
    return np.array([-x, -y, scene.net_pot.grid_z_mm - FREE_MM - float(points_mm[:, 2].max())])


def maximum_scale(points_mm: Array, scene: Scene) -> float:
    """Return the maximum scale factor, rounded down to three digits, at which points (N, 3) fit below the grid."""
    height_mm = scene.net_pot.grid_z_mm - FREE_MM - scene.canister.floor_z_mm
    most = min(scene.canister.inner_radius_mm / max(_circle(points_mm)[1], 1e-12), height_mm / max(float(np.ptp(points_mm[:, 2])), 1e-12))
    digit = 10.0 ** (np.floor(np.log10(most)) - 2)
    return float(np.floor(most / digit * (1.0 - 1e-9)) * digit)


def _circle(points_mm: Array) -> tuple[tuple[float, float], float]:
    """Return centre and radius of the smallest enclosing circle of points seen from above."""
    (x, y), _ = cv2.minEnclosingCircle(np.ascontiguousarray(points_mm[:, None, :2], np.float32))
    return (float(x), float(y)), float(np.hypot(points_mm[:, 0] - x, points_mm[:, 1] - y).max())


def check_in_water(points_mm: Array, scene: Scene, *, what: str) -> None:
    """Raise an error for points (N, 3), in mm in the canister frame, outside the water (inner wall, floor, surface).

    Parameters
    ----------
    points_mm : (N, 3) array
        Points of the surface.
    scene : Scene
        Scene with canister, grid and water.
    what : str
        Name of the object, used in the message.

    Raises
    ------
    UserError
        With the violated limit, the distance and position, all limits, and a placement that fits.
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
            f"The specimen is not inside the water: {what} extends {distances_mm[worst]:.2f} mm {where} at ({x:.1f}, {y:.1f}, {z:.1f}) mm; "
            f"move or shrink it. It is {format_size(points_mm)} mm; the water extends to radius {canister.inner_radius_mm:g}, "
            f"from z {canister.floor_z_mm:g} to {scene.water.level_mm:g} mm (z = 0 is the rim, the axis is x = y = 0). "
            f"{_advice(points_mm, scene)}"
        )


def format_size(points_mm: Array) -> str:
    """Return the size of points (N, 3) along x, y and z as text."""
    return " x ".join(f"{value:.3g}" for value in np.ptp(points_mm, axis=0))


def _advice(points_mm: Array, scene: Scene) -> str:
    most = maximum_scale(points_mm, scene)
    if most >= 1.0:
        x, y, z = translation_below_grid(points_mm, scene)
        return f"--place auto moves it below the grid, as does --shift-mm={x:.1f},{y:.1f},{z:.1f} from its present position."
    x, y, z = translation_below_grid(most * points_mm, scene)
    return (
        f"It is too large for the space below the grid; --scale {most:g} --place auto fits (relative to its present size), "
        f"as does --scale {most:g} --shift-mm={x:.1f},{y:.1f},{z:.1f}; if it should fit unscaled, check its unit."
    )
