"""What hangs in the water and sways: a specimen and its hairs, moved from view to view."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from rhizotwin.scenes import frames
from rhizotwin.sim.specimen import SpecimenSolid


@dataclass(frozen=True)
class Hanging:
    """A specimen, or its hairs, that hang from the top and sway."""

    name: str
    """Of the shape in the scene."""
    vertices: NDArray[np.float64]
    """(V, 3) at rest, mm."""
    share: NDArray[np.float64]
    """(V,) of the lowest tip's way that each vertex goes."""

    @staticmethod
    def of(name: str, vertices: NDArray[np.float64], solid: SpecimenSolid) -> Hanging:
        """Return vertices (V, 3) that hang from a solid's highest point: what is deeper goes farther, in proportion.

        Parameters
        ----------
        name : str
            Of the shape in the scene.
        vertices : (V, 3) array
            At rest, mm.
        solid : SpecimenSolid
            What they hang from, with its lowest tip.

        Returns
        -------
        Hanging
            With the share of the tip's way for each vertex.
        """
        low, high = solid.extents_min_mm[2], solid.extents_max_mm[2]
        return Hanging(name, vertices, np.clip((high - vertices[:, 2]) / max(float(high - low), 1e-9), 0.0, None))

    def at(self, tip_mm: tuple[float, float], twist_deg: float) -> NDArray[np.float64]:
        """Return the vertices (V, 3) when the lowest tip hangs aside by x, y and is turned about the z axis."""
        return frames.twisted(self.vertices, self.share, twist_deg) + self.share[:, None] * np.array([*tip_mm, 0.0])


def sway(scene: mi.Scene, hanging: Sequence[Hanging], tip_mm: tuple[float, float], twist_deg: float = 0.0) -> None:
    """Put what hangs where it is in a view.

    Parameters
    ----------
    scene : mi.Scene
        As `optics.build` made it.
    hanging : sequence of Hanging
        What hangs, as it is at rest.
    tip_mm : tuple of float
        How far aside the lowest tip is, x and y.
    twist_deg : float
        How far it is turned about the z axis.
    """
    parameters = mi.traverse(scene)
    for one in hanging:
        parameters[f"{one.name}.vertex_positions"] = np.ascontiguousarray(one.at(tip_mm, twist_deg), dtype=np.float32).ravel()
    parameters.update()
