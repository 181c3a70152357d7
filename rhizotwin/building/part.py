"""Definition of a printed part: solid, orientation on the print bed, and positions on the rig."""

import math
from dataclasses import dataclass, field

import numpy as np
from manifold3d import Manifold
from numpy.typing import NDArray

from rhizotwin.scenes import frames
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.frames import Array

FLIPPED = np.diag([1.0, -1.0, -1.0, 1.0])
"""Rotation (4, 4) about x by 180 degrees, for parts that are printed upside down."""
UPRIGHT: Array = np.eye(4)


@dataclass(frozen=True, kw_only=True)
class Dimension:
    """Dimension of a part, which is drawn as a line between two of its points."""

    name: str
    from_mm: tuple[float, float, float]
    to_mm: tuple[float, float, float]


@dataclass(frozen=True, kw_only=True)
class Part:
    """Part of the rig that is made by 3D printing."""

    name: str
    about: str
    """Purpose of the part in one sentence."""
    solid: Manifold
    """Solid in the coordinate frame of the part."""
    bed_from_part: Array = field(default_factory=lambda: UPRIGHT)
    """Rotation (4, 4) from the frame of the part to its orientation on the print bed. A translation in the matrix has
    no effect."""
    rig_from_part: tuple[Array, ...] = ()
    """Poses (4, 4) in the rig frame, one per piece."""
    apart_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Displacement of the part in the exploded view, in the rig frame."""
    dimensions: tuple[Dimension, ...] = ()
    support: str = ""
    """Places that need a support structure, or reason why overhangs need none. It is empty if the part has no
    overhangs."""
    numbers: tuple[tuple[str, float, str], ...] = ()
    """Name, value and source of each parameter. The ending of the name states whether the value is in mm, in degrees or
    a number of pieces."""

    @property
    def printed(self) -> Manifold:
        """Solid in the orientation on the print bed.

        The solid is centred at x = y = 0, and its lowest point is at z = 0.
        """
        lying = self.solid.transform(self.bed_from_part[:3])
        low_x, low_y, low_z, high_x, high_y, _ = lying.bounding_box()
        return lying.translate((-(low_x + high_x) / 2.0, -(low_y + high_y) / 2.0, -low_z))

    @property
    def size_mm(self) -> tuple[float, float, float]:
        """Width, depth and height of the part in its orientation on the print bed."""
        low_x, low_y, low_z, high_x, high_y, high_z = self.printed.bounding_box()
        return high_x - low_x, high_y - low_y, high_z - low_z

    @property
    def pieces(self) -> int:
        """Number of pieces to print."""
        counted = [round(value) for name, value, _ in self.numbers if name == "pieces"]
        return counted[0] if counted else max(len(self.rig_from_part), 1)

    def placed(self) -> list[Manifold]:
        """Return the solid of each piece at its position in the rig frame."""
        return [self.solid.transform(place[:3]) for place in self.rig_from_part]


def surface(solid: Manifold) -> tuple[Array, NDArray[np.int64]]:
    """Return the vertices (V, 3) of a solid's surface in mm, and its triangles (F, 3)."""
    mesh = solid.to_mesh64()
    return np.asarray(mesh.vert_properties[:, :3], dtype=np.float64), np.asarray(mesh.tri_verts, dtype=np.int64)


def check_bed(part: Part, bed_mm: tuple[float, float, float]) -> None:
    """Check that the bed of the printer is large enough for a part.

    The part may be rotated by 90 degrees about the vertical axis.

    Raises
    ------
    UserError
        If the part does not fit.
    """
    wide, deep, high = part.size_mm
    room = sorted(bed_mm[:2])
    if high > bed_mm[2] or sorted((wide, deep))[0] > room[0] or max(wide, deep) > room[1]:
        raise UserError(
            f"the part {part.name} ({wide:.0f} x {deep:.0f} x {high:.0f} mm) does not fit the printer's build volume of "
            f"{bed_mm[0]:g} x {bed_mm[1]:g} x {bed_mm[2]:g} mm; use a larger printer, and give its build volume with --bed-mm"
        )


def check_whole(part: Part) -> None:
    """Check that a part is a single solid.

    Raises
    ------
    UserError
        If the dimensions divide the part into several pieces, or leave nothing of it.
    """
    pieces = len(part.solid.decompose())
    if pieces != 1:
        raise UserError(
            f"the part {part.name} would consist of {pieces} pieces with these dimensions; compare those of the purchased parts "
            "(--measures) with the real ones"
        )


def round_up(length_mm: float) -> float:
    """Round a length up to 0.01 mm, so that a value copied from a message is accepted."""
    return math.ceil(100.0 * (length_mm + 1e-9)) / 100.0


def moved(x_mm: float, y_mm: float, z_mm: float, *, turn_deg: float = 0.0) -> Array:
    """Return the transform (4, 4) that rotates about z and then translates.

    Parameters
    ----------
    x_mm, y_mm, z_mm : float
        Translation.
    turn_deg : float
        Rotation angle, counter-clockwise as seen from above.

    Returns
    -------
    (4, 4) array
        Rigid transform, mm.
    """
    return np.asarray(frames.translation(x_mm, y_mm, z_mm) @ frames.rotation_z(np.deg2rad(turn_deg)))
