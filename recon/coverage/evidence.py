"""Evidence to which root tubes are fitted: the coverage in all views, and outlines derived from it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.calibration.cameras import Cameras
from rhizotwin.recon.coverage.light import Light
from rhizotwin.recon.coverage.silhouettes import TRACE, UNSEEN_PX, UPSAMPLING, Image, Mask, Silhouette, Window, blur_coverage
from rhizotwin.recon.device import Float, Kernel, UInt32, Vector3f, halves, select_parts, vectors
from rhizotwin.recon.optics import projection
from rhizotwin.recon.optics.projection import Projected, ViewBank

Array = NDArray[np.float64]

_TRACE_BLUR_PX = 0.6
"""Standard deviation of the Gaussian blur that is applied before the threshold `TRACE`, px. The blur suppresses the
noise of single pixels."""
_TRACE_SLACK_PX = 0.25
"""Distance by which the generous outline is moved outwards, px. It is half the spacing of the samples of the distance
map."""
_FULL = 0.9
"""Coverage above which a pixel counts as fully covered. The difference from 1 allows for noise."""
_AROUND = 1.5
"""Distance around a bright spot within which all pixels must be fully covered, in diameters of the spot. Around a
bubble in front of a ball of 20 mm, 2 mm inside the ball's outline in the picture, the pixels are fully covered up to
1.9 diameters (`hard-1`)."""
CORE_PX = 1.25
"""Minimum distance of core points from the border of full coverage, in every view, px. Core points lie in a taproot, a
hypocotyl or a solid, which is then at least 3.5 px wide."""


@dataclass(frozen=True)
class Evidence:
    """Opacity of all views with its weight, with the cameras."""

    bank: ViewBank
    """Views packed for projection; pixel coordinates are relative to the first pixel of ``window``."""
    silhouettes: tuple[Silhouette, ...]
    """Silhouettes of the views, cropped to ``window``, in the order of ``bank``."""
    opacity: Kernel
    """mi.Float16, (V, H, W) flattened: light that roots absorb, relative to an opaque root. It includes the noise of
    the pictures, whereas coverage is zero below the noise level. The opacity of masks is their coverage."""
    usable: Kernel
    """mi.Float16, (V, H, W) flattened: weight of the pixels, which is 1 for usable pixels, and 0 for others."""
    window: Window
    """Part of the pictures that is stored, the same in all views. No view shows a root outside the window."""
    light: Light = Light()
    """Light parameters of the roots."""
    tops_mm: tuple[tuple[float, float, float], ...] = ()
    """Attachment points of the plants, which the net pot hides, in the canister frame, mm. The tuple is empty if they
    are unknown."""

    @staticmethod
    def from_silhouettes(bank: ViewBank, silhouettes: Sequence[Silhouette], window: Window | None = None) -> Evidence:
        """Copy silhouettes to the device, cropped to a window.

        Parameters
        ----------
        bank : ViewBank
            Views packed for projection, for uncropped pictures.
        silhouettes : (V,) Silhouette
            Uncropped silhouettes of the views, in the order of ``bank``.
        window : Window, optional
            Part of the pictures that contains all roots. By default, it is determined from the silhouettes.
        """
        window = window or Window.around(silhouettes)
        cut = tuple(silhouette.cut(window) for silhouette in silhouettes)
        opacity = halves([s.coverage if s.opacity is None else s.opacity for s in cut])
        return Evidence(bank.crop(window.low_px), cut, opacity, halves([s.usable for s in cut]), window)

    def with_cameras(self, cameras: Cameras) -> Evidence:
        """Return this evidence with other cameras, which must be in the order of the views."""
        return replace(self, bank=ViewBank.pack(cameras.views, cameras.optics).crop(self.window.low_px))

    @property
    def is_mask(self) -> bool:
        """Return whether a view is a mask, which has no noise and does not show how much light roots absorb."""
        return any(silhouette.opacity is None for silhouette in self.silhouettes)

    def exclude(self, covered: NDArray[np.bool_]) -> Evidence:
        """Mark pixels (V, H, W) that other objects cover as not usable."""
        usable = self.usable * halves(list(~covered))
        dr.eval(usable)
        return replace(self, usable=usable)

    def select_views(self, which: Sequence[int]) -> Evidence:
        """Return the evidence of the views with the given indices."""
        if list(which) == list(range(self.bank.count)):
            return self  # without a copy
        opacity, usable = (select_parts(part, which, self.pixels) for part in (self.opacity, self.usable))
        return replace(
            self, bank=self.bank.select(which), silhouettes=tuple(self.silhouettes[k] for k in which), opacity=opacity, usable=usable
        )

    @property
    def image_wh(self) -> tuple[int, int]:
        """Return the width and height of the window, px."""
        return self.window.size_px

    @property
    def size(self) -> tuple[UInt32, UInt32]:
        """Return the width and height of the window, px, as inputs of a kernel (mi.UInt32)."""
        width, height = (dr.opaque(mi.UInt32, edge) for edge in self.image_wh)
        return width, height

    @property
    def pixels(self) -> int:
        """Return the number of pixels per view."""
        return self.image_wh[0] * self.image_wh[1]

    def project(self, points_mm: Array) -> Nodes:
        """Project points (N, 3), canister frame, mm, into all views."""
        p = projection.project_into_all(self.bank, points_mm)
        width, height = (mi.Float(edge) for edge in self.size)
        p.visible &= (p.px.x > 1.0) & (p.px.x < width - 2.0) & (p.px.y > 1.0) & (p.px.y < height - 2.0)
        dr.eval(p.px, p.du, p.dv, p.visible)  # evaluated together, to project once
        return Nodes((self.bank.count, len(points_mm)), p)


@dataclass(frozen=True)
class Nodes:
    """Projections of points into all views.

    They are stored on the device, and copied to NumPy arrays on demand.
    """

    shape: tuple[int, int]
    """Number of views V and number of points N."""
    on_device: Projected
    """Projections of all points, view by view. ``visible`` is only true for points within the picture."""

    @cached_property
    def px(self) -> Array:
        """Pixel coordinates (V, N, 2) of the points, px."""
        return self._read(self.on_device.px)

    @cached_property
    def du(self) -> Array:
        """Gradient (V, N, 3) of the picture column with respect to the position of the point, px/mm."""
        return self._read(self.on_device.du)

    @cached_property
    def dv(self) -> Array:
        """Gradient (V, N, 3) of the picture row with respect to the position of the point, px/mm."""
        return self._read(self.on_device.dv)

    @cached_property
    def visible(self) -> NDArray[np.bool_]:
        """Whether each view shows each point exactly once, and within the picture (V, N)."""
        return np.array(self.on_device.visible).reshape(self.shape)

    def _read(self, vector: Kernel) -> Array:
        return np.stack([np.array(part, np.float64).reshape(self.shape) for part in vector], axis=-1)

    def sine(self, direction: Array) -> Array:
        """Return the sine (V, N) of the angle between a unit direction (N, 3) at each point and the line of sight."""
        p = self.on_device
        return np.array(sine_to_sight(p.du, p.dv, self.in_all_views(vectors(direction))), np.float64).reshape(self.shape)

    def in_all_views(self, values: Vector3f) -> Vector3f:
        """Repeat one vector per point for each view.

        ``values`` is a mi.Vector3f (N,), and the result is a flattened mi.Vector3f (V, N).
        """
        return dr.gather(mi.Vector3f, values, projection.pair_all(*self.shape)[1])


def sine_to_sight(du: Vector3f, dv: Vector3f, direction: Vector3f) -> Float:
    """Return the sine of the angle between unit directions and the lines of sight, mi.Float.

    Parameters
    ----------
    du, dv : Vector3f
        Gradients of picture column and row with respect to the position, px/mm. Both gradients are perpendicular to the
        line of sight.
    direction : Vector3f
        Unit directions in the canister frame.
    """
    along = dr.dot(dr.normalize(dr.cross(du, dv)), direction)
    return dr.sqrt(dr.maximum(1 - dr.square(along), 0.0))


def generous_outline(silhouette: Silhouette) -> Image:
    """Return the signed distance (2 H, 2 W), px, to an outline that contains even the thinnest roots.

    This generous outline also contains pixels without roots. The best estimate of the outline is that of
    `silhouettes.signed_distance`.
    """
    return _distance(silhouette, blur_coverage(silhouette, _TRACE_BLUR_PX), TRACE) + np.float32(_TRACE_SLACK_PX)


def core_outline(silhouette: Silhouette) -> Image:
    """Return a signed distance (2 H, 2 W), px, that is positive only deep inside full coverage."""
    # Pixels that are not usable may be root, up to their rim.
    return _distance(silhouette, np.where(silhouette.usable, silhouette.coverage, np.float32(1.0)), _FULL) - np.float32(CORE_PX)


def bright_spots(silhouette: Silhouette) -> Mask:
    """Return the mask (H, W) of small bright spots that are surrounded by full coverage.

    Such spots are caused, for example, by bubbles in front of thick roots. A spot is included if all other pixels
    within `_AROUND` times its diameter are fully covered. Gaps between crossing roots do not qualify: they are as wide
    as roots, and lie beside other gaps.
    """
    full = ((silhouette.coverage > _FULL) | ~silhouette.usable).astype(np.uint8)
    count, label, stats, _ = cv2.connectedComponentsWithStats(1 - full, connectivity=4)
    spots = np.zeros(full.shape, bool)
    for number in range(1, count):
        left, top, width, height, area = (int(part) for part in stats[number])
        reach = int(np.ceil(_AROUND * np.sqrt(4.0 / np.pi * area))) + 1
        if min(left, top) < reach or left + width + reach > full.shape[1] or top + height + reach > full.shape[0]:
            continue
        part = np.s_[top - reach : top + height + reach, left - reach : left + width + reach]
        hole = label[part] == number
        depth = cv2.distanceTransform(full[part] | hole.astype(np.uint8), cv2.DIST_L2, 5)
        if depth[hole].min() >= reach - 1:
            spots[part] |= hole
    return spots


def _distance(silhouette: Silhouette, picture: Image, level: float) -> Image:
    """Return the signed distance to the contour of a picture at a given level, px.

    The distance is accurate to half a pixel. At pixels that are not usable, it is `UNSEEN_PX`.
    """
    size = (picture.shape[1] * UPSAMPLING, picture.shape[0] * UPSAMPLING)
    unseen = cv2.resize(silhouette.usable.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) == 0
    inside = ((cv2.resize(picture, size, interpolation=cv2.INTER_LINEAR) > level) | unseen).astype(np.uint8)
    depth, beyond = (cv2.distanceTransform(part, cv2.DIST_L2, 5) for part in (inside, 1 - inside))
    distance = ((depth - beyond) / UPSAMPLING).astype(np.float32)
    distance[cv2.dilate(unseen.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0] = UNSEEN_PX
    return distance
