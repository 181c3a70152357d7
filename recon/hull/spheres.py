"""Spheres inside roots, and the volume of their union."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from rhizotwin.recon.hull.bodies import Bodies, fill
from rhizotwin.recon.hull.leaves import Leaves

Array = NDArray[np.float64]

_NEIGHBOURS = 4
"""Number of nearest sphere centres that are tested in the search for the nearest sphere. They are searched separately
in each group of spheres whose radii differ by less than a factor of two."""


@dataclass(frozen=True)
class Spheres:
    """Spheres inside the roots."""

    centre_mm: Array
    """Centres of the spheres, shape (N, 3), canister frame, mm."""
    radius_mm: Array
    """Radii of the spheres, shape (N,), mm."""

    @property
    def bodies(self) -> Bodies:
        """Return the spheres as bodies that fill leaves."""
        return Bodies.spheres(self.centre_mm, self.radius_mm)

    def select(self, which: NDArray[np.bool_] | slice) -> Spheres:
        """Return a subset of the spheres, selected by a mask (N,) or a slice."""
        return Spheres(self.centre_mm[which], self.radius_mm[which])


def join(parts: Sequence[Spheres]) -> Spheres:
    """Return all spheres of several sets."""
    none = np.zeros((0, 3)), np.zeros(0)
    centres, radii = zip(none, *((part.centre_mm, part.radius_mm) for part in parts), strict=True)
    return Spheres(np.concatenate(centres), np.concatenate(radii))


def shared_volume_mm3(spheres: Spheres, leaves: Leaves) -> float:
    """Return the volume of the intersection of spheres and leaves, mm3."""
    return fill(spheres.bodies, leaves).volume_mm3()


def beyond_mm(spheres: Spheres, points: Array) -> Array:
    """Return the distance (N,) of points (N, 3) from the union of spheres, mm. It is approximate for points inside."""
    beyond, octave = np.full(len(points), np.inf), np.floor(np.log2(spheres.radius_mm))
    for one in np.unique(octave):
        some = np.flatnonzero(octave == one)
        away, near = cKDTree(spheres.centre_mm[some]).query(points, k=list(range(1, min(_NEIGHBOURS, len(some)) + 1)), workers=-1)
        beyond = np.minimum(beyond, (away - spheres.radius_mm[some][near]).min(axis=1))
    return beyond
