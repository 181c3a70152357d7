"""Errors of camera poses, with the correlations between views."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rhizotwin.scenes.frames import Array


@dataclass(frozen=True, kw_only=True)
class PoseErrors:
    """Errors of views' poses: the left-hand twist (rad, mm) of view v is ``carry[v] @ s + e[v]``, all of mean zero.

    The S shared errors s are those of inset (px), focus (relative), six of each station's camera, and four of the strip
    on the table: tilt about x, y and offset in x, y.
    """

    shared: Array
    """(S, S) covariance of s."""
    carry: Array
    """(V, 6, S)."""
    own: Array
    """(V, 6, 6) covariances of e, independent between views."""

    def covariance(self) -> Array:
        """Return the covariance (V, 6, 6) of each pose."""
        return np.asarray(self.carry @ self.shared @ self.carry.transpose(0, 2, 1) + self.own)

    def reorder(self, views: Sequence[int | None], alone: Sequence[Array | None]) -> PoseErrors:
        """Return the errors of views in another order.

        None denotes a view without shared errors, with its own covariance (6, 6) in ``alone``.
        """
        count = self.shared.shape[0]
        carry, own = np.zeros((len(views), 6, count)), np.zeros((len(views), 6, 6))
        for k, (view, covariance) in enumerate(zip(views, alone, strict=True)):
            if view is not None:
                carry[k], own[k] = self.carry[view], self.own[view]
            elif covariance is not None:
                own[k] = covariance
        return PoseErrors(shared=self.shared, carry=carry, own=own)
