"""A root system as a tree of tubes, with what it was fitted to."""

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
    """Roots found as tubes, with what they were fitted to."""

    tubes: Tubes
    solid: Mask
    """(N,) nodes in what no root explains: spheres, boxes and bulbs."""
    solids_mm: Array
    """(M, 3) points deep inside of these, whose shape the trimmed hull gives."""
    margin_mm: float
    """Within this of such a point lies the whole of a solid."""
    px_a_mm: float
    attenuation: TubeAttenuation
    """How much light roots let through."""
    learned_per_mm: float | None = None
    """Attenuation as the widest roots seem to have it."""
    seen: Evidence
    """What it was fitted to."""
    cameras: Cameras
    """Those of ``seen``."""

    @property
    def thick(self) -> Mask:
        """Return the nodes (N,) of thick roots."""
        return organs.is_thick(self.tubes, self.px_a_mm)


@dataclass(frozen=True, kw_only=True)
class RootSystem(RootTree):
    """Roots at rest."""

    uncertain: Mask
    """(N,) nodes of ends whose tips are likely none."""

    @cached_property
    def drawn(self) -> Rendering:
        """The roots as the views show them."""
        return Rendering.of(self.seen, self.tubes)

    def roots(self) -> tuple[Root, ...]:
        """Return the branches as roots, parents before children, each from where it leaves its parent's inside."""
        number, centre = np.full(len(self.solid), -1), self.tubes.centre_mm  # the root that each node is of
        roots: list[Root] = []
        for k, nodes in enumerate(self.tubes.branches):
            diameters = 2.0 * self.tubes.radii(k)
            for run in np.split(np.arange(len(nodes)), np.flatnonzero(np.diff(self.solid[nodes].astype(np.int64))) + 1):
                own = nodes[run]
                if self.solid[own[0]] or len(own) < 2:
                    continue
                parent = int(number[own[0]]) if run[0] == 0 and k > 0 else -1
                number[own[number[own] < 0]] = len(roots)
                order, seen = (roots[parent].order + 1 if parent >= 0 else 0), not (self.uncertain | self.solid)[nodes[run[-1]]]
                root = Root(points_mm=centre[own], diameters_mm=diameters[run], order=order, parent=parent, tip_seen=seen)
                roots.append(root)
        return thick_lines.emerged(hierarchy.arrange(roots))
