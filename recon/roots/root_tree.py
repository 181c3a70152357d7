"""Root system as a tree of tubes, with the measured coverage to which it was fitted."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.calibration.cameras import Cameras
from rhizotwin.recon.coverage.evidence import Evidence
from rhizotwin.recon.roots import hierarchy, organs
from rhizotwin.recon.tubes.tube_attenuation import TubeAttenuation
from rhizotwin.recon.tubes.tube_picture import Rendering
from rhizotwin.recon.tubes.tubes import Tubes
from rhizotwin.scenes import thickened_roots
from rhizotwin.scenes.rsml import Root

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True)
class RootTree:
    """Roots as a tree of tubes, with the measured coverage to which they were fitted."""

    tubes: Tubes
    solid: Mask
    """Mask of nodes inside solids that no root explains, such as balls, boxes and bulbs, shape (N,)."""
    solids_mm: Array
    """Points inside the solids, far from their surface, shape (M, 3), canister frame, mm. The shape of the solids is
    that of the trimmed hull."""
    core_mm: Array
    """Points inside thick roots, solids and clusters of roots, far from their surface, shape (M, 3), mm."""
    margin_mm: float
    """Maximum distance of any point of the solids from the points in `solids_mm`, and of thick roots from those in
    `core_mm`, mm."""
    px_a_mm: float
    has_crown: bool
    """Whether the first branch is an artificial one, to which plants or roots are attached (`roots.crown`)."""
    attenuation: TubeAttenuation
    """Attenuation of light by the roots."""
    learned_per_mm: float = np.inf
    """Attenuation estimated from the widest roots, 1/mm. It is infinite if they are opaque, or if there is no
    estimate."""
    evidence: Evidence
    """Measured coverage of all views, to which the tubes were fitted."""
    cameras: Cameras
    """Cameras of the views in `evidence`."""

    @property
    def thick(self) -> Mask:
        """Return the mask (N,) of the nodes of thick roots."""
        return organs.is_thick(self.tubes, self.px_a_mm)


@dataclass(frozen=True, kw_only=True)
class RootSystem(RootTree):
    """Refined root tree, in which uncertain branch ends are marked."""

    uncertain: Mask
    """Mask of nodes at branch ends that are probably not root tips, shape (N,)."""
    nodule: Mask
    """Mask of nodes of nodules and other swellings, which are not roots, shape (N,)."""

    @cached_property
    def rendering(self) -> Rendering:
        """Rendering of the roots in all views."""
        return Rendering.draw(self.evidence, self.tubes)

    def roots(self) -> tuple[Root, ...]:
        """Return the branches as roots. Parents come before children.

        Laterals begin on the centre line of their parent, or at most `thickened_roots.BURIED_MM` below the surface of a
        thickened parent.
        """
        number, centre = np.full(len(self.solid), -1), self.tubes.centre_mm  # index of each node's root
        roots: list[Root] = []
        for k, nodes in enumerate(self.tubes.branches):
            diameters = 2.0 * self.tubes.radii(k)
            for run in np.split(np.arange(len(nodes)), np.flatnonzero(np.diff(self.solid[nodes].astype(np.int64))) + 1):
                own = nodes[run]
                if self.solid[own[0]] or len(own) < 2 or self.nodule[own[-1]]:
                    continue
                parent = int(number[own[0]]) if run[0] == 0 and k > 0 else -1
                number[own[number[own] < 0]] = len(roots)
                tip_seen = bool(own[-1] == nodes[-1] and not self.uncertain[nodes[-1]])  # a root that enters a solid has no tip there
                root = Root(points_mm=centre[own], diameters_mm=diameters[run], order=0, parent=parent, tip_seen=tip_seen)
                roots.append(root)
        return thickened_roots.trim_buried(hierarchy.arrange(roots))

    def nodules(self) -> tuple[Root, ...]:
        """Return the nodules as lines without parents and tips."""
        lines = [(nodes, self.tubes.radii(k)) for k, nodes in enumerate(self.tubes.branches) if self.nodule[nodes[-1]]]
        points = self.tubes.centre_mm
        return tuple(Root(points_mm=points[n], diameters_mm=2.0 * radii, order=0, parent=-1, tip_seen=False) for n, radii in lines)
