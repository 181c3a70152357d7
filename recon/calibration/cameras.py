"""Cameras of a scan: poses, optics, uncertainties, and the source of the calibration."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.calibration.canister_pose import CanisterPose
from rhizotwin.recon.optics.cameras import STILL, Sway, View
from rhizotwin.recon.optics.refraction import Optics
from rhizotwin.recon.read_pictures import LeftOut
from rhizotwin.scenes import model
from rhizotwin.scenes.frames import Array


@dataclass(frozen=True, kw_only=True)
class Camera:
    """Camera of one picture."""

    file: str
    """Name of the picture's file."""
    ring: int
    used: bool
    reason: str | None = None
    """Reason for which the view is left out."""
    cam_from_canister: Array | None = None
    """(4, 4), OpenCV axes; None if not found. A view that is left out may still have a pose."""
    cam_from_tank: Array | None = None
    """(4, 4) pose of the tank; None if there is no tank, or if it is unknown."""
    sway: Sway = STILL
    """Displacement of the roots in this picture, estimated from the roots."""
    reprojection_px: float | None = None
    """Root mean square reprojection error of the measured corners for this pose, with outliers weighted down."""
    single_view_px: float | None = None
    """The same for the pose from this picture alone."""
    markers: int = 0
    outliers: int = 0
    """Number of markers with negligible weight due to large residuals."""
    table_deg: float | None = None
    """Table angle estimated from the pictures."""
    covariance: Array | None = None
    """(6, 6) of the left-hand twist of cam_from_canister: rotation vector (rad), shift (mm), in the camera's frame."""
    position_sigma_mm: float | None = None
    """Standard deviation of the camera's centre, all axes combined."""
    rotation_sigma_deg: float | None = None
    sha256: str = ""
    """Checksum of the picture's file; empty if not computed."""

    def with_pose(self, cam_from_canister: Array, covariance: Array) -> Camera:
        """Return the camera with a pose (4, 4) and covariance (6, 6)."""
        return replace(
            self,
            cam_from_canister=cam_from_canister,
            covariance=covariance,
            position_sigma_mm=float(np.sqrt(np.trace(covariance[3:, 3:]))),
            rotation_sigma_deg=float(np.rad2deg(np.sqrt(np.trace(covariance[:3, :3])))),
        )


@dataclass(frozen=True, kw_only=True)
class Ring:
    """Camera of one turn of the table, or of the part of a turn between two placements of the camera."""

    ring: int
    placement: int
    cam_from_rig: Array
    """(4, 4)"""
    covariance: Array
    """(6, 6) as in `Camera`."""
    own_deg: float
    """Standard deviation (per axis) of the camera's movement between the views, estimated from the pictures; 0 for a
    static camera."""
    own_mm: float


@dataclass(frozen=True, kw_only=True)
class BareUncertainty:
    """Uncertainty of cameras without markers: standard deviations, as root mean squares over the views."""

    scale: float
    """Relative standard deviation of the scale, from the measured diameter of the canister and its edges."""
    azimuth_rad: float
    """Standard deviation of a view's angle."""
    lift_mm: float
    """Standard deviation of a view's vertical shift."""
    mm_per_px: float


@dataclass(frozen=True)
class RigUncertainty:
    """Uncertainty of the rig from markers and edges."""

    station: NDArray[np.int64]
    """(F,) station of each frame."""
    covariance: Array
    """(5 + 6 R, 5 + 6 R) of the focal scale, the canister's tilt about x, y (rad) and offset x, y (mm) in its own
    frame, and the left-hand twist (rad, mm) of each station's camera."""
    turn: Array
    """(F,) standard deviation of each frame's table angle (rad)."""

    @property
    def stations(self) -> int:
        """Number R of stations."""
        return (len(self.covariance) - 5) // 6


@dataclass(frozen=True, kw_only=True)
class StripCalibration:
    """Calibration from the markers of all pictures together."""

    rings: tuple[Ring, ...] = ()
    table_from_canister: Array | None = None
    """(4, 4) pose of the canister on the table, or of the strip while that of the canister is unknown: tilt and
    offset."""
    inset_px: float = 0.0
    """Amount by which the markers appear larger on each side (blur in pictures that are not linear in light)."""
    focal_scale: float = 1.0
    """Ratio of the focal lengths used to the given ones."""
    focal_found: float | None = None
    """The estimated ratio, whether significant and used or not."""
    focal_sigma: float | None = None
    before_px: float | None = None
    """Median reprojection error of the views with the commanded table angles and one nominal pose of the canister."""
    after_px: float | None = None
    """Median reprojection error of the views after the fit."""


@dataclass(frozen=True, kw_only=True)
class MarkerCalibration(StripCalibration):
    """The same with the pose of the canister from its edges, and the sharpness of the pictures."""

    table_sigma: Array | None
    """(4,) standard deviations of tilt about x, y (deg) and of offset x, y (mm), of the strip from its markers and of
    the canister in the strip from its edges combined."""
    table_correction_deg: float | None
    """Standard deviation of the table angles about the commanded ones."""
    canister: CanisterPose | None
    """None if the canister's edges were not visible."""
    blur_px: float | None = None
    """Median blur of the markers, including the pixel's own (0.29); None if not measured."""
    refocus_px: float | None = None
    """Additional blur of the least sharp picture relative to the sharpest (root of the difference of squares); None if
    too few markers were measured."""


@dataclass(frozen=True, kw_only=True)
class RootCalibration:
    """Calibration of the rig from the roots."""

    n_water: float
    """Refractive index estimated from the roots."""
    n_water_sigma: float
    n_water_given: float
    focal_scale: float
    """Ratio of the focal lengths to those from the markers."""
    believed: bool
    """Whether the estimated index and cameras were used."""
    nodes: int
    before_px: float
    """Root mean square lateral distance between roots and tubes in the pictures, with each node at its best
    position."""
    after_px: float
    """The same with the corrected rig."""


@dataclass(frozen=True, kw_only=True)
class Cameras:
    """Cameras of all pictures of the root."""

    lens: model.Camera
    """Shared by all views."""
    optics: Optics
    """Optics between camera and roots."""
    all: tuple[Camera, ...]
    """(F,) cameras of all frames, in their order, followed by those whose pictures were not read."""
    order: tuple[int, ...]
    """(V,) numbers of the frames that are used, in the order of processing."""
    uncertainty: RigUncertainty | None = None
    """None if the cameras were given and count as exact."""
    bare: BareUncertainty | None = None
    """For cameras without markers."""
    markers: MarkerCalibration | None = None
    """None if the cameras were given."""
    roots: RootCalibration | None = None
    """None if there were too few roots."""
    warnings: tuple[str, ...] = ()

    @staticmethod
    def from_views(views: Sequence[View], optics: Optics, uncertainty: RigUncertainty | None = None) -> Cameras:
        """Return cameras of views (V,) with one lens."""
        every = tuple(
            Camera(file="", ring=0, used=True, cam_from_canister=view.cam_from_canister, cam_from_tank=view.cam_from_tank) for view in views
        )
        return Cameras(lens=views[0].camera, optics=optics, all=every, order=tuple(range(len(views))), uncertainty=uncertainty)

    @cached_property
    def views(self) -> tuple[View, ...]:
        """Lens and pose (V,) of the views that are used, in their order."""
        return tuple(self._view(k) for k in self.order)

    @cached_property
    def by_frame(self) -> dict[int, View]:
        """The views that are used, by frame number."""
        return dict(zip(self.order, self.views, strict=True))

    def _view(self, frame: int) -> View:
        one = self.all[frame]
        return View(camera=self.lens, cam_from_canister=self.pose(frame), cam_from_tank=one.cam_from_tank, sway=one.sway)

    def pose(self, frame: int) -> Array:
        """Return ``cam_from_canister`` (4, 4) of a frame that has a pose."""
        pose = self.all[frame].cam_from_canister
        if pose is None:
            raise ValueError(f"{self.all[frame].file} has no camera pose")
        return pose

    def reorder(self, order: Sequence[int]) -> Cameras:
        """Return the same cameras with another order of frames (V,)."""
        return replace(self, order=tuple(order))

    def leave_out(self, reasons: Mapping[int, str], *, unread: Sequence[LeftOut] = ()) -> Cameras:
        """Return the cameras with some frames left out, by number with the reason, and unread frames appended."""
        every = tuple(replace(camera, used=False, reason=reasons[k]) if k in reasons else camera for k, camera in enumerate(self.all))
        notes = tuple(f"{self.all[k].file} is left out: {reason}" for k, reason in reasons.items())
        order = tuple(k for k in self.order if k not in reasons)
        every += tuple(Camera(file=frame.file, ring=frame.ring, used=False, reason=reason) for frame, reason in unread)
        return replace(self, all=every, order=order, warnings=(*self.warnings, *notes))

    def with_views(self, views: Sequence[View], optics: Optics) -> Cameras:
        """Return cameras with other poses of the used views (V,), all of one lens, and other optics."""
        every = list(self.all)
        for k, view in zip(self.order, views, strict=True):
            every[k] = replace(every[k], cam_from_canister=view.cam_from_canister, cam_from_tank=view.cam_from_tank, sway=view.sway)
        return replace(self, lens=views[0].camera, optics=optics, all=tuple(every))
