"""A root system as a tree of tubes, with the evidence it was fitted to."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.calibration.cameras import Cameras
from rhizotwin.recon.coverage.evidence import Evidence
from rhizotwin.recon.roots import hierarchy, organs, thick_lines
from rhizotwin.recon.tubes.tube_attenuation import TubeAttenuation
from rhizotwin.recon.tubes.tube_picture import Rendering
from rhizotwin.recon.tubes.tubes import Tubes
from rhizotwin.scenes.rsml import Root

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True)
class RootTree:
    """Roots as tubes, with the evidence they were fitted to."""

    tubes: Tubes
    solid: Mask
    """(N,) nodes within solids that no root explains, such as spheres, boxes and bulbs."""
    solids_mm: Array
    """(M, 3) points deep inside the solids, whose shape the trimmed hull defines."""
    margin_mm: float
    """Distance from these points that contains the whole solid."""
    px_a_mm: float
    attenuation: TubeAttenuation
    """Attenuation of light by the roots."""
    learned_per_mm: float | None = None
    """Attenuation estimated from the widest roots."""
    evidence: Evidence
    """Evidence that the tubes were fitted to."""
    cameras: Cameras
    """Cameras of the views in the evidence."""

    @property
    def thick(self) -> Mask:
        """Return the mask (N,) of nodes of thick roots."""
        return organs.is_thick(self.tubes, self.px_a_mm)


@dataclass(frozen=True, kw_only=True)
class RootSystem(RootTree):
    """The refined root tree."""

    uncertain: Mask
    """(N,) nodes of ends that probably have no tip."""

    @cached_property
    def rendering(self) -> Rendering:
        """The roots rendered in all views."""
        return Rendering.draw(self.evidence, self.tubes)

    def roots(self) -> tuple[Root, ...]:
        """Return the branches as roots, parents before children, each from the surface of its parent."""
        number, centre = np.full(len(self.solid), -1), self.tubes.centre_mm  # index of each node's root
        roots: list[Root] = []
        for k, nodes in enumerate(self.tubes.branches):
            diameters = 2.0 * self.tubes.radii(k)
            for run in np.split(np.arange(len(nodes)), np.flatnonzero(np.diff(self.solid[nodes].astype(np.int64))) + 1):
                own = nodes[run]
                if self.solid[own[0]] or len(own) < 2:
                    continue
                parent = int(number[own[0]]) if run[0] == 0 and k > 0 else -1
                number[own[number[own] < 0]] = len(roots)
                order, tip_seen = (roots[parent].order + 1 if parent >= 0 else 0), not (self.uncertain | self.solid)[nodes[run[-1]]]
                root = Root(points_mm=centre[own], diameters_mm=diameters[run], order=order, parent=parent, tip_seen=tip_seen)
                roots.append(root)
        return thick_lines.trim_buried(hierarchy.arrange(roots))
