"""The cameras of a scan: where each stood, through what it looks, how sure that is, and what told it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.calibration.canister_pose import CanisterPose
from rhizotwin.recon.optics.cameras import STILL, Sway, View
from rhizotwin.recon.optics.refraction import Optics
from rhizotwin.recon.pictures import LeftOut
from rhizotwin.scenes import model
from rhizotwin.scenes.frames import Array


@dataclass(frozen=True, kw_only=True)
class Camera:
    """The camera of one picture."""

    file: str
    """The picture's."""
    ring: int
    used: bool
    reason: str | None = None
    """Why the view is left out."""
    cam_from_canister: Array | None = None
    """(4, 4), OpenCV axes; None where it was not found. A view that is left out may still have one."""
    cam_from_tank: Array | None = None
    """(4, 4) how a tank stands to it; None where there is none, or nobody knows."""
    sway: Sway = STILL
    """How far the roots were aside in this picture, as they told."""
    reprojection_px: float | None = None
    """Root mean square distance of the measured corners from where this pose puts them, outliers weighted down."""
    single_view_px: float | None = None
    """The same for the pose from this picture alone."""
    markers: int = 0
    outliers: int = 0
    """Markers that count for nearly nothing, since they lie far off."""
    table_deg: float | None = None
    """Table angle as the pictures tell it."""
    covariance: Array | None = None
    """(6, 6) of the left-hand twist of cam_from_canister: rotation vector (rad), shift (mm), in the camera's frame."""
    position_sigma_mm: float | None = None
    """Standard deviation of the camera's centre, all axes together."""
    rotation_sigma_deg: float | None = None
    sha256: str = ""
    """Of the picture's file, by which it is known again; empty where nobody asked."""

    def placed(self, cam_from_canister: Array, covariance: Array) -> Camera:
        """Return the camera at a pose (4, 4) of a covariance (6, 6)."""
        return replace(
            self,
            cam_from_canister=cam_from_canister,
            covariance=covariance,
            position_sigma_mm=float(np.sqrt(np.trace(covariance[3:, 3:]))),
            rotation_sigma_deg=float(np.rad2deg(np.sqrt(np.trace(covariance[:3, :3])))),
        )


@dataclass(frozen=True, kw_only=True)
class Ring:
    """Where the camera stood for one turn of the table, or the part of it until it was placed anew."""

    ring: int
    placement: int
    cam_from_rig: Array
    """(4, 4)"""
    covariance: Array
    """(6, 6) as in `Camera`."""
    own_deg: float
    """Standard deviation (each axis) of the camera's movement between the views, found from the pictures; 0 for a still
    camera."""
    own_mm: float


@dataclass(frozen=True, kw_only=True)
class BareUncertainty:
    """How well cameras without markers are known: standard deviations, root mean squares over the views."""

    scale: float
    """Share of the scale: the canister's diameter, as a person measured it and as its edges show it."""
    azimuth_rad: float
    """Of a view's angle."""
    lift_mm: float
    """Of how far a view is lifted."""
    mm_per_px: float


@dataclass(frozen=True)
class RigUncertainty:
    """How well markers and edges know the rig."""

    station: NDArray[np.int64]
    """(F,) to which standing of the camera each frame belongs."""
    covariance: Array
    """(5 + 6 R, 5 + 6 R) of the focal scale, the canister's tilt about x, y (rad) and offset x, y (mm) in its own
    frame, and the left-hand twist (rad, mm) of each station's camera."""
    turn: Array
    """(F,) standard deviation of each frame's table angle (rad)."""

    @property
    def stations(self) -> int:
        """Number R of standings of the camera."""
        return (len(self.covariance) - 5) // 6


@dataclass(frozen=True, kw_only=True)
class StripCalibration:
    """What the markers of all pictures together gave."""

    rings: tuple[Ring, ...] = ()
    table_from_canister: Array | None = None
    """(4, 4) how the canister (or while that is not known, the strip) stands on the table: tilt and offset."""
    inset_px: float = 0.0
    """How much larger on each side the markers look than they are (blur in pictures that are not linear in light)."""
    focal_scale: float = 1.0
    """Focal lengths over the given ones, as they were taken."""
    focal_found: float | None = None
    """The same, whether it is sure enough to be taken or not."""
    focal_sigma: float | None = None
    before_px: float | None = None
    """Median reprojection error of the views with the commanded table angles and one nominal pose of the canister."""
    after_px: float | None = None
    """Median reprojection error of the views at the end."""


@dataclass(frozen=True, kw_only=True)
class MarkerCalibration(StripCalibration):
    """The same with what the canister's edges told, and how the pictures look."""

    table_sigma: Array | None
    """(4,) standard deviations of tilt about x, y (deg) and of offset x, y (mm): of the strip by its markers and of the
    canister in the strip by its edges together."""
    table_correction_deg: float | None
    """Spread of the table's angles about the commanded ones."""
    canister: CanisterPose | None
    """None where the canister's edges were not seen."""
    blur_px: float | None = None
    """Median blur of the markers, the pixel's own (0.29) included; None where it was not measured."""
    refocus_px: float | None = None
    """By how much the least sharp picture is blurred more than the sharpest one (difference of squares, its root); None
    where too few markers were measured."""


@dataclass(frozen=True, kw_only=True)
class RootCalibration:
    """What the roots themselves told of the rig."""

    n_water: float
    """As the roots would have it."""
    n_water_sigma: float
    n_water_given: float
    focal_scale: float
    """Focal lengths over those that the markers told."""
    believed: bool
    """Whether index and cameras were taken as the roots would have them."""
    nodes: int
    before_px: float
    """Root mean square distance sideways of the roots in the pictures from where the tubes put them, each node at its
    best place."""
    after_px: float
    """The same when the rig is changed as found."""


@dataclass(frozen=True, kw_only=True)
class Cameras:
    """The cameras of all pictures of the root."""

    lens: model.Camera
    """One for all views."""
    optics: Optics
    """What they look through."""
    all: tuple[Camera, ...]
    """(F,) of every frame, in the order of the frames; behind them those whose pictures were not read."""
    order: tuple[int, ...]
    """(V,) numbers of the frames that are used, in the order in which they are looked at."""
    uncertainty: RigUncertainty | None = None
    """None: the cameras were given and count as exact."""
    bare: BareUncertainty | None = None
    """Of cameras without markers."""
    markers: MarkerCalibration | None = None
    """None: the cameras were given."""
    roots: RootCalibration | None = None
    """None: no roots could be asked."""
    warnings: tuple[str, ...] = ()

    @staticmethod
    def given(views: Sequence[View], optics: Optics, uncertainty: RigUncertainty | None = None) -> Cameras:
        """Return cameras of views (V,) of one lens."""
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
        """The views that are used, by number of the frame."""
        return dict(zip(self.order, self.views, strict=True))

    def _view(self, frame: int) -> View:
        one = self.all[frame]
        return View(camera=self.lens, cam_from_canister=self.pose(frame), cam_from_tank=one.cam_from_tank, sway=one.sway)

    def pose(self, frame: int) -> Array:
        """Return ``cam_from_canister`` (4, 4) of a frame that has one."""
        pose = self.all[frame].cam_from_canister
        if pose is None:
            raise ValueError(f"{self.all[frame].file} has no camera pose")
        return pose

    def ordered(self, order: Sequence[int]) -> Cameras:
        """Return the same cameras, to be looked at in another order of frames (V,)."""
        return replace(self, order=tuple(order))

    def without(self, reasons: Mapping[int, str], *, unread: Sequence[LeftOut] = ()) -> Cameras:
        """Return the same cameras with some frames left out, by number with the reason, and the unread ones behind."""
        every = tuple(replace(camera, used=False, reason=reasons[k]) if k in reasons else camera for k, camera in enumerate(self.all))
        said = tuple(f"{self.all[k].file} is left out: {reason}" for k, reason in reasons.items())
        order = tuple(k for k in self.order if k not in reasons)
        every += tuple(Camera(file=frame.file, ring=frame.ring, used=False, reason=reason) for frame, reason in unread)
        return replace(self, all=every, order=order, warnings=(*self.warnings, *said))

    def moved(self, views: Sequence[View], optics: Optics) -> Cameras:
        """Return cameras whose used views (V,), all of one lens, stand elsewhere, or look through something else."""
        every = list(self.all)
        for k, view in zip(self.order, views, strict=True):
            every[k] = replace(every[k], cam_from_canister=view.cam_from_canister, cam_from_tank=view.cam_from_tank, sway=view.sway)
        return replace(self, lens=views[0].camera, optics=optics, all=tuple(every))
