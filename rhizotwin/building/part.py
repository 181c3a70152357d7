"""Printed part with its solid, its orientation on the print bed, and its positions on the rig."""

from dataclasses import dataclass, field

import numpy as np
from manifold3d import Manifold
from numpy.typing import NDArray

from rhizotwin.scenes import frames
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.frames import Array

FLIPPED = np.diag([1.0, -1.0, -1.0, 1.0])
"""Rotation to upside down."""
UPRIGHT: Array = np.eye(4)


@dataclass(frozen=True, kw_only=True)
class Dimension:
    """Dimension to be drawn, between two points of the part."""

    name: str
    from_mm: tuple[float, float, float]
    to_mm: tuple[float, float, float]


@dataclass(frozen=True, kw_only=True)
class Part:
    """Part to be printed."""

    name: str
    about: str
    """Purpose of the part in a sentence."""
    solid: Manifold
    """Solid in the frame of the part."""
    bed_from_part: Array = field(default_factory=lambda: UPRIGHT)
    """(4, 4) rotation to the printing orientation; the height has no effect."""
    rig_from_part: tuple[Array, ...] = ()
    """(4, 4) positions on the rig, one per piece."""
    apart_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Displacement in the exploded view, in the rig frame."""
    dimensions: tuple[Dimension, ...] = ()
    support: str = ""
    """Places that need support, or reason why an overhang can be bridged; empty if no support is needed."""
    numbers: tuple[tuple[str, float, str], ...] = ()
    """Parameters: name, value in mm, degrees or pieces according to the name, and source of the value."""

    @property
    def printed(self) -> Manifold:
        """Solid in printing orientation, centred at the origin, its lowest point at z = 0."""
        lying = self.solid.transform(self.bed_from_part[:3])
        low_x, low_y, low_z, high_x, high_y, _ = lying.bounding_box()
        return lying.translate((-(low_x + high_x) / 2.0, -(low_y + high_y) / 2.0, -low_z))

    @property
    def size_mm(self) -> tuple[float, float, float]:
        """Width, depth and height in printing orientation."""
        low_x, low_y, low_z, high_x, high_y, high_z = self.printed.bounding_box()
        return high_x - low_x, high_y - low_y, high_z - low_z

    @property
    def pieces(self) -> int:
        """Number of pieces to print."""
        counted = [round(value) for name, value, _ in self.numbers if name == "pieces"]
        return counted[0] if counted else max(len(self.rig_from_part), 1)

    def placed(self) -> list[Manifold]:
        """Return the solids at their positions in the rig frame."""
        return [self.solid.transform(place[:3]) for place in self.rig_from_part]


def surface(solid: Manifold) -> tuple[Array, NDArray[np.int64]]:
    """Return the vertices (V, 3) and triangles (F, 3) of a solid."""
    mesh = solid.to_mesh64()
    return np.asarray(mesh.vert_properties[:, :3], dtype=np.float64), np.asarray(mesh.tri_verts, dtype=np.int64)


def check_bed(part: Part, bed_mm: tuple[float, float, float]) -> None:
    """Reject a part that does not fit the printer, in its orientation or rotated by 90 degrees.

    Raises
    ------
    UserError
        If the part does not fit.
    """
    wide, deep, high = part.size_mm
    room = sorted(bed_mm[:2])
    if high > bed_mm[2] or sorted((wide, deep))[0] > room[0] or max(wide, deep) > room[1]:
        raise UserError(
            f"{part.name} ({wide:.0f} x {deep:.0f} x {high:.0f} mm) does not fit the build volume of "
            f"{bed_mm[0]:g} x {bed_mm[1]:g} x {bed_mm[2]:g} mm; give a larger --bed-mm"
        )


def moved(x_mm: float, y_mm: float, z_mm: float, *, turn_deg: float = 0.0) -> Array:
    """Return the transform (4, 4) that rotates about z and then translates.

    Parameters
    ----------
    x_mm, y_mm, z_mm : float
        Translation.
    turn_deg : float
        Rotation, counter-clockwise as seen from above.

    Returns
    -------
    (4, 4) array
        Transform.
    """
    return np.asarray(frames.translation(x_mm, y_mm, z_mm) @ frames.rotation_z(np.deg2rad(turn_deg)))
