"""Cameras of a scan: poses, lens, optics, uncertainties, and the calibration from which they were obtained."""

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
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.frames import Array

LEAST_VIEWS = 3
"""Minimum number of views for a reconstruction. Two silhouettes do not bound a shape."""
HELD_OUT = "it is held out for rhizotwin verify"
"""Reason why a view is excluded that was held out (`recon.settings.PictureSettings.hold_out`)."""


@dataclass(frozen=True, kw_only=True)
class Camera:
    """Camera pose of one picture, with its quality and uncertainty."""

    file: str
    """File name of the picture in the dataset."""
    ring: int
    """Index of the ring to which the picture belongs."""
    used: bool
    """Whether the view is used for the reconstruction."""
    reason: str | None = None
    """Reason why the view is excluded; None for used views."""
    cam_from_canister: Array | None = None
    """(4, 4) transform from the canister frame to the camera's frame, mm, OpenCV axes; None if it could not be
    estimated. An excluded view may have a pose."""
    cam_from_tank: Array | None = None
    """(4, 4) transform from the tank's frame to the camera's frame, mm; None if there is no tank or if the pose is
    unknown."""
    sway: Sway = STILL
    """Displacement of the roots in this picture, estimated from the reconstructed roots."""
    reprojection_px: float | None = None
    """Root mean square reprojection error of the measured marker corners, px, with outliers down-weighted."""
    markers: int = 0
    """Number of markers measured in the picture."""
    table_deg: float | None = None
    """Table angle estimated from the pictures, degrees; None if unknown."""
    covariance: Array | None = None
    """(6, 6) covariance of the error of ``cam_from_canister``. The error is a twist in the camera's frame, applied from
    the left: a rotation vector, rad, and a shift, mm."""
    position_sigma_mm: float | None = None
    """Standard deviation of the camera's position, mm. It is the square root of the summed variances along the three
    axes."""
    rotation_sigma_deg: float | None = None
    """Standard deviation of the camera's rotation, degrees. It is the square root of the summed variances about the
    three axes."""
    sha256: str = ""
    """SHA-256 hash of the picture's file; empty if not computed."""

    def with_pose(self, cam_from_canister: Array, covariance: Array) -> Camera:
        """Return this camera with another pose (4, 4) and covariance (6, 6)."""
        return replace(
            self,
            cam_from_canister=cam_from_canister,
            covariance=covariance,
            position_sigma_mm=float(np.sqrt(np.trace(covariance[3:, 3:]))),
            rotation_sigma_deg=float(np.rad2deg(np.sqrt(np.trace(covariance[:3, :3])))),
        )


@dataclass(frozen=True, kw_only=True)
class Ring:
    """Camera of one station.

    A station is a full turn of the table, or the part of a turn that was taken from one placement of the camera.
    """

    ring: int
    """Index of the ring."""
    placement: int
    """Index of the camera's placement within the ring."""
    cam_from_rig: Array
    """(4, 4) transform from the rig's frame to the frame of the static camera, mm."""
    covariance: Array
    """(6, 6) covariance of the error of ``cam_from_rig``. The error is a twist applied from the left: a rotation
    vector, rad, and a shift, mm."""
    own_deg: float
    """Standard deviation of the camera's small rotations between the views of the station, degrees per axis. It is
    estimated from the pictures, and is 0 if the camera did not move."""
    own_mm: float
    """Standard deviation of the camera's small translations between the views of the station, mm per axis. It is
    estimated from the pictures, and is 0 if the camera did not move."""


@dataclass(frozen=True, kw_only=True)
class BareUncertainty:
    """Standard deviations of camera parameters that were estimated without markers.

    Standard deviations of the individual views are combined by their root mean square.
    """

    scale: float
    """Relative standard deviation of the scale, due to the measured diameter of the canister and the measured positions
    of its edges."""
    azimuth_rad: float
    """Standard deviation of a view's azimuth, rad."""
    lift_mm: float
    """Standard deviation of a view's vertical shift, mm."""
    mm_per_px: float
    """Scale of the pictures, mm per pixel."""


@dataclass(frozen=True)
class RigUncertainty:
    """Uncertainty of the rig parameters estimated from the markers and the canister's edges."""

    station: NDArray[np.int64]
    """(F,) index of each frame's station."""
    covariance: Array
    """(5 + 6 R, 5 + 6 R) covariance of the rig parameters for R stations. The parameters are, in this order, the focal
    scale, the canister's tilt about x and y, rad, its offset in x and y, mm, both in the canister's own frame, and the
    twist of each station's camera, rad and mm, applied from the left."""
    turn: Array
    """(F,) standard deviation of each frame's table angle, rad."""

    @property
    def stations(self) -> int:
        """Return the number R of stations."""
        return (len(self.covariance) - 5) // 6


@dataclass(frozen=True, kw_only=True)
class StripCalibration:
    """Joint calibration of all cameras from the markers in all pictures."""

    rings: tuple[Ring, ...] = ()
    """Static cameras of the stations."""
    table_from_canister: Array | None = None
    """(4, 4) pose of the canister relative to the turntable, mm, which consists of a tilt and an offset. It is the pose
    of the marker strip until the pose of the canister in the strip is known."""
    inset_px: float = 0.0
    """Distance by which each side of a marker appears shifted outwards in the pictures, px. Blur causes this
    enlargement if pixel values are not proportional to light intensity."""
    focal_scale: float = 1.0
    """Ratio of the focal lengths used in the reconstruction to those of the calibrated lens."""
    focal_found: float | None = None
    """Estimated ratio of the focal lengths to those of the calibrated lens. The estimate is stored even if it did not
    differ significantly from 1 and was therefore not used. It is None if the ratio was not estimated."""
    focal_sigma: float | None = None
    """Standard deviation of ``focal_found``; None if not estimated."""
    before_px: float | None = None
    """Median reprojection error of the views before the joint fit, px. It is computed with the commanded table angles
    and one nominal pose of the canister."""
    after_px: float | None = None
    """Median reprojection error of the views after the fit, px."""


@dataclass(frozen=True, kw_only=True)
class MarkerCalibration(StripCalibration):
    """Calibration from the markers, together with the canister's pose and the sharpness of the pictures.

    The pose of the canister in the strip is estimated from the canister's edges.
    """

    table_sigma: Array | None
    """(4,) standard deviations of the canister's tilt about x and y on the table, degrees, and its offset in x and y,
    mm. They include the errors of the markers and those of the canister's edges."""
    table_correction_deg: float | None
    """Standard deviation of the differences between estimated and commanded table angles, degrees. It is None if no
    angles were commanded."""
    canister: CanisterPose | None
    """Pose of the canister in the strip; None if the canister's edges were not visible."""
    blur_px: float | None = None
    """Standard deviation of the blur at the markers, px, including 0.29 px of the pixel itself. It is the median over
    all markers, or None if the blur was not measured."""
    refocus_px: float | None = None
    """Standard deviation of the additional blur of the least sharp picture relative to the sharpest, px. It is the
    square root of the difference between the variances of the two blurs. It is None if too few markers were
    measured."""


@dataclass(frozen=True, kw_only=True)
class RootCalibration:
    """Calibration of the rig from the reconstructed roots."""

    n_water: float
    """Refractive index of the water estimated from the roots."""
    n_water_sigma: float
    """Standard deviation of ``n_water``."""
    n_water_given: float
    """Refractive index of the water stated in the scene."""
    focal_scale: float
    """Ratio of the focal lengths estimated from the roots to the focal lengths estimated from the markers."""
    believed: bool
    """Whether the estimated refractive index and cameras are used."""
    nodes: int
    """Number of root nodes used in the estimate."""
    before_px: float
    """Root mean square distance between the observed roots and the fitted root tubes before the calibration, px. It is
    measured in the pictures across the roots, with each node at its best-fitting position."""
    after_px: float
    """Root mean square distance between the observed roots and the fitted root tubes after the calibration, px. It is
    measured in the pictures across the roots, with each node at its best-fitting position."""


@dataclass(frozen=True, kw_only=True)
class Cameras:
    """Cameras of all pictures of the roots."""

    lens: model.Camera
    """Lens shared by all views."""
    optics: Optics
    """Canister, water and tank as an optical system between the cameras and the roots."""
    all: tuple[Camera, ...]
    """(F,) cameras of all frames, in the order of the frames, followed by the cameras of pictures that were not read.
    """
    order: tuple[int, ...]
    """(V,) frame numbers of the used views, in processing order."""
    uncertainty: RigUncertainty | None = None
    """Uncertainty of the rig parameters from the markers. None if the cameras were given, in which case they are
    treated as exact, or calibrated without markers (``bare``)."""
    bare: BareUncertainty | None = None
    """Uncertainty of cameras calibrated without markers; None for other cameras."""
    markers: MarkerCalibration | None = None
    """Calibration from the markers; None if the cameras were given or calibrated without markers."""
    roots: RootCalibration | None = None
    """Calibration from the roots; None if there were too few roots."""
    warnings: tuple[str, ...] = ()

    @cached_property
    def views(self) -> tuple[View, ...]:
        """Return the lens and pose of each used view (V,), in processing order."""
        return tuple(self._view(k) for k in self.order)

    @cached_property
    def by_frame(self) -> dict[int, View]:
        """Return the used views, keyed by frame number."""
        return dict(zip(self.order, self.views, strict=True))

    def _view(self, frame: int) -> View:
        one = self.all[frame]
        return View(camera=self.lens, cam_from_canister=self.pose(frame), cam_from_tank=one.cam_from_tank, sway=one.sway)

    def pose(self, frame: int) -> Array:
        """Return the pose ``cam_from_canister`` (4, 4) of a frame; raise ValueError if the frame has no pose."""
        pose = self.all[frame].cam_from_canister
        if pose is None:
            raise ValueError(f"{self.all[frame].file} has no camera pose")
        return pose

    def leave_out(self, reasons: Mapping[int, str], *, unread: Sequence[LeftOut] = ()) -> Cameras:
        """Exclude the frames in ``reasons``, and append unread frames.

        ``reasons`` maps frame numbers to the reasons for the exclusion. Each excluded frame adds a warning.
        """
        every = tuple(replace(camera, used=False, reason=reasons[k]) if k in reasons else camera for k, camera in enumerate(self.all))
        notes = tuple(f"{self.all[k].file} is excluded: {reason}" for k, reason in reasons.items())
        order = tuple(k for k in self.order if k not in reasons)
        every += tuple(Camera(file=frame.file, ring=frame.ring, used=False, reason=reason) for frame, reason in unread)
        return replace(self, all=every, order=order, warnings=(*self.warnings, *notes))

    def hold_out(self, every: int) -> Cameras:
        """Exclude every ``every``-th of the used views, and keep their poses. None is excluded if ``every`` is 0.

        Raises
        ------
        UserError
            If too few views remain, or if the cameras were estimated from the roots of all pictures.
        """
        if not every:
            return self
        if self.bare is not None:
            raise UserError(
                "without markers, the cameras are estimated from the roots of all pictures, so that none can be held out; "
                "remove --hold-out, and compare the result with another scan by 'rhizotwin score --pictures'"
            )
        held = sorted(self.order)[every - 1 :: every]
        if len(self.order) - len(held) < LEAST_VIEWS:
            raise UserError(
                f"--hold-out {every} leaves {len(self.order) - len(held)} of {len(self.order)} pictures, but at least {LEAST_VIEWS} are "
                "required; use a larger number"
            )
        return replace(self.leave_out(dict.fromkeys(held, HELD_OUT)), warnings=self.warnings)

    @property
    def held_out(self) -> dict[int, Camera]:
        """Return the cameras of the pictures that were held out, keyed by frame number."""
        return {k: camera for k, camera in enumerate(self.all) if camera.reason == HELD_OUT}

    def with_views(self, views: Sequence[View], optics: Optics) -> Cameras:
        """Return the cameras with other poses of the used views (V,) and with other optics.

        The lens is also replaced by that of the views, which share one lens.
        """
        every = list(self.all)
        for k, view in zip(self.order, views, strict=True):
            every[k] = replace(every[k], cam_from_canister=view.cam_from_canister, cam_from_tank=view.cam_from_tank, sway=view.sway)
        return replace(self, lens=views[0].camera if views else self.lens, optics=optics, all=tuple(every))
