"""Errors of camera poses, and their correlations between views."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rhizotwin.scenes.frames import Array


@dataclass(frozen=True, kw_only=True)
class PoseErrors:
    """Covariance model of the errors of the views' poses.

    The error of view v is ``carry[v] @ s + e[v]``, a twist (rad, mm) applied from the left. Both s and e have zero
    mean.

    The S errors s are shared by all views: inset (px), focus (relative), six components for each station's camera, and
    four for the strip on the table (tilt about x and y, offset in x and y).
    """

    shared: Array
    """(S, S) covariance of the shared errors s."""
    carry: Array
    """(V, 6, S) derivatives of each view's twist with respect to the shared errors s."""
    own: Array
    """(V, 6, 6) covariance of the error e of each view, which is independent of the other views."""

    @staticmethod
    def independent(covariances: Sequence[Array | None]) -> PoseErrors:
        """Return the errors of views that were calibrated independently, given their covariances (6, 6)."""
        none = PoseErrors(shared=np.zeros((6, 6)), carry=np.zeros((0, 6, 6)), own=np.zeros((0, 6, 6)))
        return none.reorder([None] * len(covariances), covariances)

    def covariance(self) -> Array:
        """Return the total covariance (V, 6, 6) of each view's pose."""
        return np.asarray(self.carry @ self.shared @ self.carry.transpose(0, 2, 1) + self.own)

    def reorder(self, views: Sequence[int | None], alone: Sequence[Array | None]) -> PoseErrors:
        """Return the errors of the given views, in the given order.

        None in ``views`` denotes a view that has no shared errors. The covariance (6, 6) of such a view is taken from
        ``alone``.
        """
        count = self.shared.shape[0]
        carry, own = np.zeros((len(views), 6, count)), np.zeros((len(views), 6, 6))
        for k, (view, covariance) in enumerate(zip(views, alone, strict=True)):
            if view is not None:
                carry[k], own[k] = self.carry[view], self.own[view]
            elif covariance is not None:
                own[k] = covariance
        return PoseErrors(shared=self.shared, carry=carry, own=own)
