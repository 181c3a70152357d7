"""How far every pixel of every view lies from the silhouette's outline, and how points of space are looked up there."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import cv2
import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.coverage import silhouettes
from rhizotwin.recon.coverage.silhouettes import UNSEEN_PX, UPSAMPLING, Image, Silhouette, Window
from rhizotwin.recon.device import Bool, Float, Kernel, Point3f, UInt32, Vector2f, Vector2u, bilinear, numbers, room, some_parts
from rhizotwin.recon.optics import projection
from rhizotwin.recon.optics.projection import ViewBank
from rhizotwin.scenes.monitor import Monitor

TELLS_PX = 1e-3 * UNSEEN_PX
"""Interpolated distances above this have a share of `UNSEEN_PX`: the picture says nothing there either."""
_VOTES, _FEWEST = 0.3, 3
"""Share of the views that must see a point for it to count, and their least number: two views leave open what lies
along their lines of sight."""


@dataclass(frozen=True)
class DistanceMaps:
    """Signed distances to the outlines of all views, positive inside, pixels.

    `UNSEEN_PX` where a picture says nothing.
    """

    values: Kernel
    """mi.Float16, (V, 2 h, 2 w) flattened: those of a window (w, h), about which nothing is said; infinite for
    `UNSEEN_PX`.

    Halves keep distances to 1/2048: within a pixel of an outline to 0.0003 px, a hundred pixels away to 0.03 px, where
    the maps themselves are right to 0.4 px."""
    image_wh: tuple[int, int]
    window: Window
    _low: Vector2f = field(init=False, repr=False)
    _samples: Vector2u = field(init=False, repr=False)
    _image: Vector2f = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Keep what kernels need of the sizes as their input.

        As constants, they would make every kernel new for every scan.
        """
        object.__setattr__(self, "_low", mi.Vector2f(*(dr.opaque(mi.Float, low) for low in self.window.low_px)))
        object.__setattr__(self, "_samples", mi.Vector2u(*(dr.opaque(mi.UInt32, count) for count in self.samples_wh)))
        object.__setattr__(self, "_image", mi.Vector2f(*(dr.opaque(mi.Float, count) for count in self.image_wh)))

    @staticmethod
    def of(maps: NDArray[np.floating], image_wh: tuple[int, int] | None = None, window: Window | None = None) -> DistanceMaps:
        """Put maps (V, 2 h, 2 w) on the device, infinite or `UNSEEN_PX` where a picture says nothing.

        Parameters
        ----------
        image_wh, window : tuple of int or None, Window or None
            Of the pictures, and the part of them that the maps are of; all of it where not given.
        """
        size_px = maps.shape[2] // UPSAMPLING, maps.shape[1] // UPSAMPLING
        values = mi.Float16(numbers(maps))
        dr.eval(values)
        return DistanceMaps(values, image_wh or size_px, window or Window((0, 0), size_px))

    @staticmethod
    def drawn(
        views: Sequence[Silhouette], name: str, monitor: Monitor, outline: Callable[[Silhouette], Image] = silhouettes.signed_distance
    ) -> DistanceMaps:
        """Draw the outlines of all views, within the window that holds what any of them tells.

        Parameters
        ----------
        name : str
            Of the progress bar.
        outline : callable
            From a silhouette to its signed distance (2 H, 2 W), pixels.
        """
        (height, width), window = views[0].coverage.shape, Window.around(views)
        samples = UPSAMPLING**2 * window.size_px[0] * window.size_px[1]
        values = room(len(views) * samples, np.dtype(np.float16))

        def draw(view: int) -> None:
            # `UNSEEN_PX` becomes infinite; NumPy takes five times as long, and twenty times where it does
            drawn = cv2.multiply(outline(views[view].cut(window)), 1.0, dtype=cv2.CV_16F)
            values[view * samples : (view + 1) * samples] = drawn.ravel()

        monitor.each(draw, name, range(len(views)))
        return DistanceMaps(mi.Float16(values), (width, height), window)

    @property
    def samples_wh(self) -> tuple[int, int]:
        """Return the samples of a map."""
        return self.window.size_px[0] * UPSAMPLING, self.window.size_px[1] * UPSAMPLING

    def of_views(self, which: Sequence[int]) -> DistanceMaps:
        """Return those of some of the views."""
        return replace(self, values=some_parts(self.values, which, self.samples_wh[0] * self.samples_wh[1]))

    def picture(self, view: int) -> Image:
        """Return a view's map, (2 H, 2 W) of its window, infinite where its picture says nothing."""
        width, height = self.samples_wh
        return np.array(mi.Float(self.of_views([view]).values)).reshape(height, width)

    def sample(self, px: Vector2f) -> Vector2f:
        """Return where pixels (mi.Vector2f) lie on a map, whose samples are at integers: mi.Vector2f."""
        return (px - self._low + 0.5) * UPSAMPLING - 0.5

    def at(self, view: UInt32, px: Vector2f, active: Bool) -> Float:
        """Interpolate bilinearly at pixels (mi.Vector2f)."""
        place = dr.clip(self.sample(px), 0.0, mi.Vector2f(self._samples) - 1.001)  # within the last sample
        begin = view * (self._samples.y * self._samples.x)
        return bilinear(self.values, begin, self._samples.x, place.x, place.y, active, most=UNSEEN_PX)

    def holds(self, px: Vector2f) -> Bool:
        """Tell which pixels (mi.Vector2f) lie in the pictures."""
        return dr.all((px > -0.5) & (px < self._image - 0.5))


def least_votes(count: int) -> int:
    """Return how many of so many views must see a point for it to count."""
    return max(_FEWEST, math.ceil(_VOTES * count))


def look(bank: ViewBank, maps: DistanceMaps, view: UInt32, point: Point3f, active: Bool) -> tuple[projection.Projected, Float, Bool]:
    """Project points into a view and read its distance map.

    Parameters
    ----------
    bank : ViewBank
        Views.
    maps : DistanceMaps
        Of the same views.
    view, point, active : UInt32, Point3f, Bool
        Number of the view and point, a lane each, and lanes that count.

    Returns
    -------
    Projected, mi.Float, mi.Bool
        The projection, the distance in px, and whether the picture tells.
    """
    p = projection.project(bank, view, point, active)
    return p, *read(maps, view, p.px, p.seen)


def read(maps: DistanceMaps, view: UInt32, px: Vector2f, active: Bool) -> tuple[Float, Bool]:
    """Read a view's distance map.

    Parameters
    ----------
    maps : DistanceMaps
        Of all views.
    view, px, active : UInt32, Vector2f, Bool
        Number of the view and pixel, a lane each, and lanes that count.

    Returns
    -------
    mi.Float, mi.Bool
        The distance in px, and whether the picture tells.
    """
    seen = active & maps.holds(px)
    distance = maps.at(view, px, seen)
    return distance, seen & (distance < TELLS_PX)
