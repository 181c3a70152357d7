"""A printed part, and whether it can be printed.

It has its solid as it is used, how it lies on the printer's bed, and where it stands on the rig.
"""

from dataclasses import dataclass, field

import numpy as np
from manifold3d import Manifold
from numpy.typing import NDArray

from rhizotwin.scenes import frames
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.frames import Array

FLIPPED = np.diag([1.0, -1.0, -1.0, 1.0])
"""Upside down."""
UPRIGHT: Array = np.eye(4)


@dataclass(frozen=True, kw_only=True)
class Dimension:
    """A length to be drawn, between two points of the part."""

    name: str
    from_mm: tuple[float, float, float]
    to_mm: tuple[float, float, float]


@dataclass(frozen=True, kw_only=True)
class Part:
    """One thing to be printed."""

    name: str
    about: str
    """What it is for, in a sentence."""
    solid: Manifold
    """In the part's own frame."""
    bed_from_part: Array = field(default_factory=lambda: UPRIGHT)
    """(4, 4) how it is turned for the printer; how high it lies does not matter."""
    rig_from_part: tuple[Array, ...] = ()
    """(4, 4) each, where it stands; as many as are printed."""
    apart_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """How far it is moved in the exploded view, in the rig's frame."""
    dimensions: tuple[Dimension, ...] = ()
    support: str = ""
    """Where it needs support, or why an overhang is bridged; empty: it needs none."""
    numbers: tuple[tuple[str, float, str], ...] = ()
    """Name, value in mm, degrees or pieces as the name says, and where the value comes from."""

    @property
    def printed(self) -> Manifold:
        """The solid as it lies on the bed, its middle over the origin and its lowest point at z = 0."""
        lying = self.solid.transform(self.bed_from_part[:3])
        low_x, low_y, low_z, high_x, high_y, _ = lying.bounding_box()
        return lying.translate((-(low_x + high_x) / 2.0, -(low_y + high_y) / 2.0, -low_z))

    @property
    def size_mm(self) -> tuple[float, float, float]:
        """Width, depth and height on the bed."""
        low_x, low_y, low_z, high_x, high_y, high_z = self.printed.bounding_box()
        return high_x - low_x, high_y - low_y, high_z - low_z

    @property
    def pieces(self) -> int:
        """How many are printed."""
        counted = [round(value) for name, value, _ in self.numbers if name == "pieces"]
        return counted[0] if counted else max(len(self.rig_from_part), 1)

    def placed(self) -> list[Manifold]:
        """Return the solid wherever it stands on the rig, in the rig's frame."""
        return [self.solid.transform(place[:3]) for place in self.rig_from_part]


def surface(solid: Manifold) -> tuple[Array, NDArray[np.int64]]:
    """Return the corners (V, 3) and triangles (F, 3) of a solid."""
    mesh = solid.to_mesh64()
    return np.asarray(mesh.vert_properties[:, :3], dtype=np.float64), np.asarray(mesh.tri_verts, dtype=np.int64)


def check_bed(part: Part, bed_mm: tuple[float, float, float]) -> None:
    """Refuse a part that does not fit the printer, lying as it must or turned by a quarter.

    Raises
    ------
    UserError
        With the part's size and the bed's.
    """
    wide, deep, high = part.size_mm
    room = sorted(bed_mm[:2])
    if high > bed_mm[2] or sorted((wide, deep))[0] > room[0] or max(wide, deep) > room[1]:
        raise UserError(
            f"{part.name} of {wide:.0f} x {deep:.0f} x {high:.0f} mm does not fit a bed of "
            f"{bed_mm[0]:g} x {bed_mm[1]:g} x {bed_mm[2]:g} mm; give a larger --bed-mm"
        )


def moved(x_mm: float, y_mm: float, z_mm: float, *, turn_deg: float = 0.0) -> Array:
    """Return the transform (4, 4) that turns about z and then moves.

    Parameters
    ----------
    x_mm, y_mm, z_mm : float
        Along the axes.
    turn_deg : float
        Counter-clockwise, seen from above.

    Returns
    -------
    (4, 4) array
        The transform.
    """
    return np.asarray(frames.translation(x_mm, y_mm, z_mm) @ frames.rotation_z(np.deg2rad(turn_deg)))
