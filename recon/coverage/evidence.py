"""What the pictures say about thin roots.

Coverage in all views, where a root may be, and where one is thick for certain.
"""

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
from rhizotwin.recon.coverage.silhouettes import UNSEEN_PX, UPSAMPLING, Image, Mask, Silhouette, Window, blurred
from rhizotwin.recon.device import Float, Kernel, Vector3f, halves, numbers, some_parts, vectors
from rhizotwin.recon.optics import projection
from rhizotwin.recon.optics.projection import Projected, ViewBank

Array = NDArray[np.float64]

_TRACE = 0.07
"""Blurred coverage above this may be a root: a third of a pixel wide, with the blur below."""
_TRACE_BLUR_PX = 0.6
"""Standard deviation of the blur before the threshold, against the noise of single pixels."""
_TRACE_SLACK_PX = 0.25
"""By this much the generous outline is moved out: half of a sample of the distance map."""
_FULL = 0.9
"""Coverage above this counts as full, noise allowed for."""
_AROUND = 1.5
"""Diameters of a bright spot within which nothing else breaks full coverage: a bubble before a ball of 20 mm, 2 mm from
its outline in the picture, has 1.9 (`hard-1`)."""
CORE_PX = 1.25
"""Points this deep inside full coverage in every view lie in a taproot, hypocotyl or solid: 3.5 px wide or more."""


@dataclass(frozen=True)
class Evidence:
    """Measured coverage of all views, or where roots are translucent their opacity, with the cameras."""

    bank: ViewBank
    """With the window's first pixel as the origin."""
    silhouettes: tuple[Silhouette, ...]
    """In the order of the bank's views, cut to the window."""
    coverage: Kernel
    """mi.Float16, (V, H, W) flattened: coverage, opacity where roots are translucent."""
    seen: Kernel
    """mi.Float16, (V, H, W) flattened: 1 where the picture says something, else 0."""
    window: Window
    """The part of the pictures that is kept, the same in all views: beyond it no view sees anything."""
    mu_per_mm: float | None = None
    """Attenuation of the roots; None for opaque ones."""
    hairs: float = 0.0
    """Strength of the hairs about the roots, in those of `translucent_tube.HAIRS`."""
    index: float = 1.0
    """Refractive index of the roots over that of the water; it matters where they are translucent."""
    blur_px: float = 0.0
    """Standard deviation of the pictures' blur, beside the square pixel's own."""
    tops_mm: tuple[tuple[float, float, float], ...] = ()
    """Where each of several plants hangs, behind the net pot, canister frame, mm; empty: there is one."""

    @staticmethod
    def of(bank: ViewBank, silhouettes: Sequence[Silhouette]) -> Evidence:
        """Put silhouettes on the device, cut to the window that holds all pixels seen in any view.

        Parameters
        ----------
        bank : ViewBank
            Views of whole pictures.
        silhouettes : (V,) Silhouette
            Of whole pictures, in the order of the views.
        """
        window = Window.around(silhouettes)
        cut = tuple(silhouette.cut(window) for silhouette in silhouettes)
        coverage, seen = halves([s.coverage for s in cut]), halves([s.seen for s in cut])
        return Evidence(bank.in_window(window.low_px), cut, coverage, seen, window)

    def with_cameras(self, cameras: Cameras) -> Evidence:
        """Return the same evidence seen by other cameras, in the order of the views."""
        return replace(self, bank=ViewBank.of(cameras.views, cameras.optics).in_window(self.window.low_px))

    @property
    def has_opacity(self) -> bool:
        """Tell whether the pictures were of light, and not silhouettes from the beginning."""
        return all(silhouette.opacity is not None for silhouette in self.silhouettes)

    def by_light(self) -> Evidence:
        """Return the opacity of all views as the evidence: it comes with its noise, coverage without.

        Raises
        ------
        ValueError
            Where the pictures were silhouettes from the beginning.
        """
        pictures = [s.opacity for s in self.silhouettes if s.opacity is not None]
        if len(pictures) < len(self.silhouettes):
            raise ValueError(f"only {len(pictures)} of {len(self.silhouettes)} views have an opacity")
        return replace(self, coverage=halves(pictures))

    def beside(self, covered: NDArray[np.bool_]) -> Evidence:
        """Return what the pictures say where nothing else (V, H, W) covers them."""
        seen = self.seen * halves(list(~covered))
        dr.eval(seen)
        return replace(self, seen=seen)

    def of_views(self, which: Sequence[int]) -> Evidence:
        """Return what some of the views say."""
        coverage, seen = (some_parts(part, which, self.pixels) for part in (self.coverage, self.seen))
        return replace(
            self, bank=self.bank.chosen(which), silhouettes=tuple(self.silhouettes[k] for k in which), coverage=coverage, seen=seen
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
        p.seen &= (p.px.x > 1.0) & (p.px.x < width - 2.0) & (p.px.y > 1.0) & (p.px.y < height - 2.0)
        dr.eval(p.px, p.du, p.dv, p.seen)  # one by one, each would be a projection of its own
        return Nodes((views, count), p)


@dataclass(frozen=True)
class Nodes:
    """Where points lie in all views: on the device, and as NumPy has it where somebody looks."""

    shape: tuple[int, int]
    """Views and points, V and N."""
    on_device: Projected
    """One view's points after those of another; ``seen`` only those in the picture."""

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
        """Gradient (V, N, 3) of the row."""
        return self._read(self.on_device.dv)

    @cached_property
    def seen(self) -> NDArray[np.bool_]:
        """Whether (V, N) a view sees a point, once and in its picture."""
        return np.array(self.on_device.seen).reshape(self.shape)

    def _read(self, vector: Kernel) -> Array:
        return np.stack([np.array(part, np.float64).reshape(self.shape) for part in vector], axis=-1)

    def sine(self, direction: Array) -> Array:
        """Return the sine (V, N) of the angle between a unit direction (N, 3) at each point and the lines of sight."""
        p = self.on_device
        return np.array(sine_to_sight(p.du, p.dv, self.in_all_views(vectors(direction))), np.float64).reshape(self.shape)

    def in_all_views(self, values: Vector3f) -> Vector3f:
        """Return what belongs to the points, mi.Vector3f (N,), for each view, (V, N) flattened."""
        return mi.Vector3f(*(dr.tile(part, self.shape[0]) for part in values))


def sine_to_sight(du: Vector3f, dv: Vector3f, direction: Vector3f) -> Float:
    """Return the sine of the angle between unit directions and lines of sight, mi.Float.

    Parameters
    ----------
    du, dv : Vector3f
        Gradients of column and row by the point, mi.Vector3f; along the line of sight no pixel changes.
    direction : Vector3f
        mi.Vector3f, canister frame.
    """
    along = dr.dot(dr.normalize(dr.cross(du, dv)), direction)
    return dr.sqrt(dr.maximum(1 - dr.square(along), 0.0))


def generous_outline(silhouette: Silhouette) -> Image:
    """Return a signed distance (2 H, 2 W) in pixels to a generous outline.

    `silhouettes.signed_distance` returns that to the best one.

    It is meant to hold every root, however thin, at the price of holding more.
    """
    return _distance(silhouette, blurred(silhouette, _TRACE_BLUR_PX), _TRACE) + np.float32(_TRACE_SLACK_PX)


def core_outline(silhouette: Silhouette) -> Image:
    """Return a signed distance (2 H, 2 W) in pixels, positive only deep inside full coverage."""
    # what is not seen may be root, up to its rim
    return _distance(silhouette, np.where(silhouette.seen, silhouette.coverage, np.float32(1.0)), _FULL) - np.float32(CORE_PX)


def bright_spots(silhouette: Silhouette) -> Mask:
    """Return small holes (H, W) in full coverage, such as a bubble before a thick root makes.

    A hole counts where nothing else breaks full coverage within `_AROUND` of its diameters: gaps between roots that
    cross are as wide as roots, and lie beside others.
    """
    full = ((silhouette.coverage > _FULL) | ~silhouette.seen).astype(np.uint8)
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
    """Return the signed distance to where a picture crosses a level, to half a pixel; large where nothing is said."""
    size = (picture.shape[1] * UPSAMPLING, picture.shape[0] * UPSAMPLING)
    unseen = cv2.resize(silhouette.seen.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) == 0
    inside = ((cv2.resize(picture, size, interpolation=cv2.INTER_LINEAR) > level) | unseen).astype(np.uint8)
    depth, beyond = (cv2.distanceTransform(part, cv2.DIST_L2, 5) for part in (inside, 1 - inside))
    distance = ((depth - beyond) / UPSAMPLING).astype(np.float32)
    distance[cv2.dilate(unseen.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0] = UNSEEN_PX
    return distance
