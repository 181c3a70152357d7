"""Sway of hanging objects.

The displacement of a specimen and its root hairs changes from view to view.
"""

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
    """Swaying specimen, or its root hairs.

    It is fixed at the top.
    """

    name: str
    """Name of the object's shape in the Mitsuba scene."""
    vertices: NDArray[np.float64]
    """Vertices at rest (V, 3), mm."""
    share: NDArray[np.float64]
    """Displacement of each vertex (V,), as a fraction of the displacement of the lowest tip."""

    @staticmethod
    def of(name: str, vertices: NDArray[np.float64], solid: SpecimenSolid) -> HangingObject:
        """Create a hanging object that is fixed at the highest point of a solid.

        The displacement of a vertex is proportional to its depth below this point.

        Parameters
        ----------
        name : str
            Name of the object's shape in the Mitsuba scene.
        vertices : (V, 3) array
            Vertices at rest, mm.
        solid : SpecimenSolid
            Solid whose highest point and lowest tip define the displacement.

        Returns
        -------
        HangingObject
            Hanging object with the relative displacement of each vertex.
        """
        low, high = solid.extents_min_mm[2], solid.extents_max_mm[2]
        return HangingObject(name, vertices, np.clip((high - vertices[:, 2]) / max(float(high - low), 1e-9), 0.0, None))

    def at(self, tip_mm: tuple[float, float], twist_deg: float) -> NDArray[np.float64]:
        """Return the vertices (V, 3), mm, after a displacement in x and y and a rotation about the z axis.

        Both are specified for the lowest tip.
        """
        return frames.twist(self.vertices, self.share, twist_deg) + self.share[:, None] * np.array([*tip_mm, 0.0])


def sway(scene: mi.Scene, hanging: Sequence[HangingObject], tip_mm: tuple[float, float], twist_deg: float = 0.0) -> None:
    """Move hanging objects to their positions in a view.

    Parameters
    ----------
    scene : mi.Scene
        Mitsuba scene created by `optics.build`.
    hanging : sequence of HangingObject
        Hanging objects at rest.
    tip_mm : tuple of float
        Displacement of the lowest tip in x and y, mm.
    twist_deg : float
        Rotation of the lowest tip about the z axis, deg.
    """
    parameters = mi.traverse(scene)
    for one in hanging:
        parameters[f"{one.name}.vertex_positions"] = np.ascontiguousarray(one.at(tip_mm, twist_deg), dtype=np.float32).ravel()
    parameters.update()
