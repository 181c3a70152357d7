"""Spatial index that lists, for each point, the bodies that may contain it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.device import Float, UInt32, numbers, wholes

Array = NDArray[np.float64]

_BIN_MM = 4.0
"""Edge length of a bin, mm. A body with an extent up to this length overlaps at most eight bins."""


class Bodies(Protocol):
    """Bodies that can be listed."""

    @property
    def middle_mm(self) -> Array:
        """Return the centres (N, 3) of spheres around the bodies, canister frame, mm."""

    @property
    def reach_mm(self) -> Array:
        """Return the radii (N,) of these spheres, mm."""

    @property
    def parameters(self) -> Array:
        """Return the parameters (N, K) of the bodies, where K is a multiple of 4."""


@dataclass(frozen=True)
class Bins:
    """Cubic bins, each with a list of the bodies that may overlap it."""

    low_mm: Array
    shape: NDArray[np.int64]
    entries: Float
    """Parameters of the bodies in all bins, flattened and ordered by bin."""
    begins: UInt32
    """Index of the first body of each bin, followed by the total number of bodies."""

    @staticmethod
    def build(bodies: Bodies, low_mm: Array, high_mm: Array, beside_mm: float) -> Bins:
        """Create the index for a box.

        Parameters
        ----------
        low_mm, high_mm : (3,) float64 array
            Corners of the box that contains all points that will be looked up, canister frame, mm.
        beside_mm : float
            Distance from a body within which it is listed, mm.
        """
        shape, reach = np.maximum(np.ceil((high_mm - low_mm) / _BIN_MM), 1).astype(np.int64), bodies.reach_mm[:, None] + beside_mm
        corners = bodies.middle_mm - reach, bodies.middle_mm + reach
        first, last = (np.clip(np.floor((corner - low_mm) / _BIN_MM), 0, shape - 1).astype(np.int64) for corner in corners)
        extent = last - first + 1
        count = extent.prod(axis=1)
        body = np.repeat(np.arange(len(count)), count)
        place, e = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count), extent[body]
        offset = np.stack([place // (e[:, 1] * e[:, 2]), place // e[:, 2] % e[:, 1], place % e[:, 2]], axis=1)
        bins = ((first[body] + offset) * [shape[1] * shape[2], shape[2], 1]).sum(axis=1)
        order = np.argsort(bins, kind="stable")
        begins = np.searchsorted(bins[order], np.arange(shape.prod() + 1)).astype(np.uint32)
        return Bins(low_mm, shape, numbers(bodies.parameters[body[order]].astype(np.float32)), wholes(begins))

    def find(self, points_mm: Array) -> tuple[UInt32, UInt32]:
        """Return the indices (N,) of the first listed body, and of the one after the last, for points (N, 3)."""
        cell = np.clip(np.floor((points_mm - self.low_mm) / _BIN_MM), 0, self.shape - 1).astype(np.int64)
        at = wholes(cell @ [self.shape[1] * self.shape[2], self.shape[2], 1])
        return dr.gather(mi.UInt32, self.begins, at), dr.gather(mi.UInt32, self.begins, at + 1)
