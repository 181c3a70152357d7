"""Evidence of roots in the pictures: coverage in all views, with generous outlines and outlines of thick roots."""

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
from rhizotwin.recon.coverage.silhouettes import UNSEEN_PX, UPSAMPLING, Image, Mask, Silhouette, Window, blur_coverage
from rhizotwin.recon.device import Float, Kernel, Vector3f, halves, numbers, select_parts, vectors
from rhizotwin.recon.optics import projection
from rhizotwin.recon.optics.projection import Projected, ViewBank

Array = NDArray[np.float64]

_TRACE = 0.07
"""Threshold of blurred coverage for possible roots: a third of a pixel wide, with the blur below."""
_TRACE_BLUR_PX = 0.6
"""Standard deviation of the blur before the threshold, which suppresses noise of single pixels."""
_TRACE_SLACK_PX = 0.25
"""Outward offset of the generous outline: half a sample of the distance map."""
_FULL = 0.9
"""Minimum coverage that counts as full, with a margin for noise."""
_AROUND = 1.5
"""Distance from a bright spot, in its diameters, within which full coverage must be uninterrupted: a bubble in front of
a ball of 20 mm, 2 mm from its outline in the picture, has 1.9 (`hard-1`)."""
CORE_PX = 1.25
"""Points at least this deep inside full coverage in every view lie in a taproot, hypocotyl or solid, which is then at
least 3.5 px wide."""


@dataclass(frozen=True)
class Evidence:
    """Coverage in all views, or opacity for translucent roots, with the cameras."""

    bank: ViewBank
    """Views, with the window's first pixel as the origin."""
    silhouettes: tuple[Silhouette, ...]
    """In the order of the bank's views, cropped to the window."""
    coverage: Kernel
    """mi.Float16, (V, H, W) flattened: coverage, opacity where roots are translucent."""
    usable: Kernel
    """mi.Float16, (V, H, W) flattened: 1 for usable pixels, else 0."""
    window: Window
    """Window of the pictures that is kept, the same in all views; no view has usable pixels outside it."""
    mu_per_mm: float | None = None
    """Attenuation of the roots; None for opaque roots."""
    hairs: float = 0.0
    """Strength of the root hairs, relative to `translucent_tube.HAIRS`."""
    index: float = 1.0
    """Refractive index of the roots relative to water; only used for translucent roots."""
    blur_px: float = 0.0
    """Standard deviation of the pictures' blur, in addition to that of the square pixel."""
    tops_mm: tuple[tuple[float, float, float], ...] = ()
    """Attachment points of several plants, behind the net pot, canister frame, mm; empty for a single plant."""

    @staticmethod
    def from_silhouettes(bank: ViewBank, silhouettes: Sequence[Silhouette]) -> Evidence:
        """Transfer silhouettes to the device, cropped to the window that contains the usable pixels of all views.

        Parameters
        ----------
        bank : ViewBank
            Views of whole pictures.
        silhouettes : (V,) Silhouette
            Silhouettes of whole pictures, in the order of the views.
        """
        window = Window.around(silhouettes)
        cut = tuple(silhouette.cut(window) for silhouette in silhouettes)
        coverage, usable = halves([s.coverage for s in cut]), halves([s.usable for s in cut])
        return Evidence(bank.crop(window.low_px), cut, coverage, usable, window)

    def with_cameras(self, cameras: Cameras) -> Evidence:
        """Return the same evidence with other cameras, in the order of the views."""
        return replace(self, bank=ViewBank.pack(cameras.views, cameras.optics).crop(self.window.low_px))

    @property
    def has_opacity(self) -> bool:
        """Return whether the pictures have opacity, and are not masks."""
        return all(silhouette.opacity is not None for silhouette in self.silhouettes)

    def with_opacity(self) -> Evidence:
        """Return evidence with opacity instead of coverage: opacity includes its noise, coverage does not.

        Raises
        ------
        ValueError
            If the pictures are masks.
        """
        pictures = [s.opacity for s in self.silhouettes if s.opacity is not None]
        if len(pictures) < len(self.silhouettes):
            raise ValueError(f"only {len(pictures)} of {len(self.silhouettes)} views have opacity; the others are masks")
        return replace(self, coverage=halves(pictures))

    def exclude(self, covered: NDArray[np.bool_]) -> Evidence:
        """Return the evidence outside the pixels (V, H, W) that other objects cover."""
        usable = self.usable * halves(list(~covered))
        dr.eval(usable)
        return replace(self, usable=usable)

    def select_views(self, which: Sequence[int]) -> Evidence:
        """Return the evidence of a subset of the views."""
        coverage, usable = (select_parts(part, which, self.pixels) for part in (self.coverage, self.usable))
        return replace(
            self, bank=self.bank.select(which), silhouettes=tuple(self.silhouettes[k] for k in which), coverage=coverage, usable=usable
        )

    @property
    def image_wh(self) -> tuple[int, int]:
        """Return columns and rows of the window."""
        return self.window.size_px

    @property
    def pixels(self) -> int:
        """Return the number of pixels of a view."""
        return self.image_wh[0] * self.image_wh[1]

    def project(self, points_mm: Array) -> Nodes:
        """Project points (N, 3) into all views."""
        views, count = self.bank.count, len(points_mm)
        point = mi.Point3f(*(dr.tile(numbers(part), views) for part in points_mm.T))
        p = projection.project(self.bank, dr.repeat(dr.arange(mi.UInt32, views), count), point, mi.Bool(True))
        width, height = self.image_wh
        p.visible &= (p.px.x > 1.0) & (p.px.x < width - 2.0) & (p.px.y > 1.0) & (p.px.y < height - 2.0)
        dr.eval(p.px, p.du, p.dv, p.visible)  # evaluated together, to project once
        return Nodes((views, count), p)


@dataclass(frozen=True)
class Nodes:
    """Projections of points in all views: on the device, and as NumPy arrays on demand."""

    shape: tuple[int, int]
    """Number of views and points, V and N."""
    on_device: Projected
    """Points of one view after those of another; ``visible`` only for points in the picture."""

    @cached_property
    def px(self) -> Array:
        """Pixels (V, N, 2)."""
        return self._read(self.on_device.px)

    @cached_property
    def du(self) -> Array:
        """Gradient (V, N, 3) of the column by the point, px/mm."""
        return self._read(self.on_device.du)

    @cached_property
    def dv(self) -> Array:
        """Gradient (V, N, 3) of the row by the point, px/mm."""
        return self._read(self.on_device.dv)

    @cached_property
    def visible(self) -> NDArray[np.bool_]:
        """Whether (V, N) a point is visible in a view, exactly once and within its picture."""
        return np.array(self.on_device.visible).reshape(self.shape)

    def _read(self, vector: Kernel) -> Array:
        return np.stack([np.array(part, np.float64).reshape(self.shape) for part in vector], axis=-1)

    def sine(self, direction: Array) -> Array:
        """Return the sine (V, N) of the angle between a unit direction (N, 3) at each point and the lines of sight."""
        p = self.on_device
        return np.array(sine_to_sight(p.du, p.dv, self.in_all_views(vectors(direction))), np.float64).reshape(self.shape)

    def in_all_views(self, values: Vector3f) -> Vector3f:
        """Repeat values of the points, mi.Vector3f (N,), for each view, (V, N) flattened."""
        return mi.Vector3f(*(dr.tile(part, self.shape[0]) for part in values))


def sine_to_sight(du: Vector3f, dv: Vector3f, direction: Vector3f) -> Float:
    """Return the sine of the angle between unit directions and lines of sight, mi.Float.

    Parameters
    ----------
    du, dv : Vector3f
        Gradients of column and row by the point, mi.Vector3f; both vanish along the line of sight.
    direction : Vector3f
        Unit directions, mi.Vector3f, canister frame.
    """
    along = dr.dot(dr.normalize(dr.cross(du, dv)), direction)
    return dr.sqrt(dr.maximum(1 - dr.square(along), 0.0))


def generous_outline(silhouette: Silhouette) -> Image:
    """Return a signed distance (2 H, 2 W) in pixels to a generous outline.

    `silhouettes.signed_distance` is the distance to the best outline.

    The generous outline contains every root, however thin, and also other pixels.
    """
    return _distance(silhouette, blur_coverage(silhouette, _TRACE_BLUR_PX), _TRACE) + np.float32(_TRACE_SLACK_PX)


def core_outline(silhouette: Silhouette) -> Image:
    """Return a signed distance (2 H, 2 W) in pixels, positive only deep inside full coverage."""
    # Unusable pixels may be root, up to their rim.
    return _distance(silhouette, np.where(silhouette.usable, silhouette.coverage, np.float32(1.0)), _FULL) - np.float32(CORE_PX)


def bright_spots(silhouette: Silhouette) -> Mask:
    """Return small holes (H, W) in full coverage, such as those of bubbles in front of thick roots.

    A hole counts if full coverage is otherwise uninterrupted within `_AROUND` of its diameters: gaps between crossing
    roots are as wide as roots, and lie beside others.
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
    """Return the signed distance to a level of a picture, to half a pixel; large for unusable pixels."""
    size = (picture.shape[1] * UPSAMPLING, picture.shape[0] * UPSAMPLING)
    unseen = cv2.resize(silhouette.usable.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) == 0
    inside = ((cv2.resize(picture, size, interpolation=cv2.INTER_LINEAR) > level) | unseen).astype(np.uint8)
    depth, beyond = (cv2.distanceTransform(part, cv2.DIST_L2, 5) for part in (inside, 1 - inside))
    distance = ((depth - beyond) / UPSAMPLING).astype(np.float32)
    distance[cv2.dilate(unseen.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0] = UNSEEN_PX
    return distance
