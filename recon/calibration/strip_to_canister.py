"""Combination of the marker calibration with the canister's pose in the strip, including both uncertainties.

The combined pose is ``cam_from_canister = cam_from_strip @ strip_from_canister``. The errors of the two factors are
correlated: if the strip is estimated with a tilt error, the edges yield a canister tilted in the opposite direction,
and the combined pose is almost correct.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rhizotwin.recon.calibration.cameras import Camera, RigUncertainty
from rhizotwin.recon.calibration.canister_pose import CanisterPose
from rhizotwin.recon.calibration.pose_errors import PoseErrors
from rhizotwin.recon.calibration.poses import Poses
from rhizotwin.recon.calibration.rig_fit import CANISTER
from rhizotwin.recon.calibration.view_fit import adjoint
from rhizotwin.scenes import frames
from rhizotwin.scenes.dataset import Frame
from rhizotwin.scenes.frames import Array

UNSEEN = np.array([np.deg2rad(0.1), np.deg2rad(0.1), 0.2, 0.2])
"""Standard deviations of the canister's misalignment in the strip that are assumed if its edges were not visible: tilt
about x and y, rad, and offset in x and y, mm."""


@dataclass(frozen=True, kw_only=True)
class StripToCanister:
    """Cameras in the frame of the strip, and the pose of the canister in the strip.

    The errors of the canister's tilt about x and y and of its offset in x and y are ``by_cameras @ s + e``. The errors
    s are shared by all cameras (`PoseErrors`), and the errors e are the independent errors of the edges.
    """

    solved: Poses
    """Cameras in the frame of the strip, from the markers."""
    canister_from_strip: Array
    """(4, 4) transform from the frame of the strip to the canister frame, mm."""
    covariance: Array
    """(4, 4) covariance of the independent edge errors e, rad and mm."""
    by_cameras: Array
    """(4, S) derivatives of the canister's tilt and offset with respect to the shared camera errors s."""

    @staticmethod
    def combine(solved: Poses, canister: CanisterPose | None) -> StripToCanister:
        """Combine the cameras in the strip's frame with the canister's pose in the strip.

        Without edges, the canister is assumed to be aligned with the strip, within `UNSEEN`.
        """
        if canister is None:
            nothing = np.zeros((4, len(solved.errors.shared)))
            return StripToCanister(solved=solved, canister_from_strip=np.eye(4), covariance=np.diag(UNSEEN**2), by_cameras=nothing)
        return StripToCanister(
            solved=solved,
            canister_from_strip=canister.canister_from_strip,
            covariance=canister.covariance,
            by_cameras=canister.by_cameras,
        )

    @property
    def errors(self) -> PoseErrors:
        """Errors of the camera poses in the frame of the strip."""
        return self.solved.errors

    def camera(self, k: int, view: Camera) -> Camera:
        """Convert a view's camera from the strip's frame to the canister frame, with its uncertainty."""
        if view.cam_from_canister is None:
            return view
        pose = view.cam_from_canister @ frames.invert(self.canister_from_strip)
        lever = -adjoint(pose)[:, CANISTER]
        carry = self.errors.carry[k] + lever @ self.by_cameras
        covariance = carry @ self.errors.shared @ carry.T + lever @ self.covariance @ lever.T + self.errors.own[k]
        return view.with_pose(pose, covariance)

    @property
    def table_from_canister(self) -> Array | None:
        """Return the pose (4, 4) of the canister on the table, mm; None if the views do not share one rig."""
        table_from_strip = self.solved.table_from_canister
        return None if table_from_strip is None else table_from_strip @ frames.invert(self.canister_from_strip)

    @property
    def table_sigma(self) -> Array | None:
        """Return the standard deviations (4,) of the canister's pose on the table; None if it is unknown.

        The four values are the tilt about x and y, degrees, and the offset in x and y, mm.
        """
        pose = self.table_from_canister
        if pose is None:
            return None
        by_shared, by_edges = self._on_table(pose)
        sigma = np.sqrt(np.diag(by_shared @ self.errors.shared @ by_shared.T + by_edges @ self.covariance @ by_edges.T))
        return np.concatenate([np.rad2deg(sigma[:2]), sigma[2:]])

    def _on_table(self, table_from_canister: Array) -> tuple[Array, Array]:
        """Return the derivatives of the canister's pose on the table with respect to the errors of its measurement.

        The first array (4, S) contains the derivatives with respect to the shared camera errors. The second array (4,
        4) contains the derivatives with respect to the independent errors of the edges.
        """
        by_edges = -adjoint(table_from_canister)[np.ix_(CANISTER, CANISTER)]
        own = np.zeros((4, len(self.errors.shared)))
        own[:, -4:] = np.eye(4)
        return own + by_edges @ self.by_cameras, by_edges

    def uncertainty(self, captured: Sequence[Frame], *, focus: float) -> RigUncertainty:
        """Return the uncertainty of the rig, which is the prior of the calibration from the roots.

        A view that was calibrated independently is treated as a separate station.

        Parameters
        ----------
        captured : sequence of Frame
            Frames in the order of the views.
        focus : float
            Standard deviation of the focal scale, in addition to its standard deviation from the marker calibration.
        """
        solved, shared = self.solved, self.errors.shared
        stations = [(ring.ring, ring.placement) for ring in solved.rings]
        alone = [k for k, frame in enumerate(captured) if frame.station not in stations and solved.views[k].covariance is not None]
        number = np.zeros(len(captured), np.int64)
        for k, frame in enumerate(captured):
            number[k] = stations.index(frame.station) if frame.station in stations else len(stations) + alone.index(k) if k in alone else 0
        size = 5 + 6 * (len(stations) + len(alone))
        by_shared, own = np.zeros((size, len(shared))), np.zeros((size, size))
        pose = self.table_from_canister
        if pose is None:
            by_shared[1:5], by_edges = -self.by_cameras, -np.eye(4)
        else:
            by_table, by_edges = self._on_table(pose)
            to_canister = np.linalg.inv(adjoint(pose)[np.ix_(CANISTER, CANISTER)])
            by_shared[1:5], by_edges = to_canister @ by_table, to_canister @ by_edges
        own[1:5, 1:5] = by_edges @ self.covariance @ by_edges.T
        by_shared[0, 1], own[0, 0] = 1.0, focus**2
        count = 6 * len(stations)
        by_shared[5 : 5 + count, 2 : 2 + count] = np.eye(count)
        for place, k in enumerate(alone):
            at = slice(5 + count + 6 * place, 11 + count + 6 * place)
            by_shared[at], own[at, at] = self.errors.carry[k], self.errors.own[k]
        return RigUncertainty(number, by_shared @ shared @ by_shared.T + own, solved.turn_sigma_rad)
