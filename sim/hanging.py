"""Sway of hanging objects: a specimen and its root hairs, displaced from view to view."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from rhizotwin.scenes import frames
from rhizotwin.sim.specimen import SpecimenSolid


@dataclass(frozen=True)
class HangingObject:
    """A specimen, or its root hairs, attached at the top, which sways."""

    name: str
    """Name of the shape in the scene."""
    vertices: NDArray[np.float64]
    """(V, 3) vertices at rest, mm."""
    share: NDArray[np.float64]
    """(V,) displacement of each vertex relative to that of the lowest tip."""

    @staticmethod
    def of(name: str, vertices: NDArray[np.float64], solid: SpecimenSolid) -> HangingObject:
        """Create a hanging object with vertices (V, 3), fixed at a solid's highest point.

        The displacement is proportional to the depth below that point.

        Parameters
        ----------
        name : str
            Name of the shape in the scene.
        vertices : (V, 3) array
            Vertices at rest, mm.
        solid : SpecimenSolid
            Solid, whose highest point and lowest tip define the displacement.

        Returns
        -------
        Hanging
            Hanging object with the relative displacement of each vertex.
        """
        low, high = solid.extents_min_mm[2], solid.extents_max_mm[2]
        return HangingObject(name, vertices, np.clip((high - vertices[:, 2]) / max(float(high - low), 1e-9), 0.0, None))

    def at(self, tip_mm: tuple[float, float], twist_deg: float) -> NDArray[np.float64]:
        """Return the vertices (V, 3) for a displacement of the lowest tip by x, y and its rotation about the z axis."""
        return frames.twist(self.vertices, self.share, twist_deg) + self.share[:, None] * np.array([*tip_mm, 0.0])


def sway(scene: mi.Scene, hanging: Sequence[HangingObject], tip_mm: tuple[float, float], twist_deg: float = 0.0) -> None:
    """Move hanging objects to their positions in a view.

    Parameters
    ----------
    scene : mi.Scene
        Scene created by `optics.build`.
    hanging : sequence of HangingObject
        Hanging objects at rest.
    tip_mm : tuple of float
        Displacement of the lowest tip in x and y.
    twist_deg : float
        Rotation of the lowest tip about the z axis.
    """
    parameters = mi.traverse(scene)
    for one in hanging:
        parameters[f"{one.name}.vertex_positions"] = np.ascontiguousarray(one.at(tip_mm, twist_deg), dtype=np.float32).ravel()
    parameters.update()
