"""What the pictures say about thin roots: coverage in all views, where a root may be, and where one is thick for certain."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import cv2
import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from recon.coverage.silhouettes import UNSEEN_PX, UPSAMPLING, Image, Silhouette
from recon.device import numbers, wholes
from recon.optics import projection
from recon.optics.projection import ViewBank

Array = NDArray[np.float64]

_TRACE = 0.07
"""Blurred coverage above this may be a root: a third of a pixel wide, with the blur below."""
_TRACE_BLUR_PX = 0.6
_TRACE_SLACK_PX = 0.25
_FULL = 0.9
CORE_PX = 1.25
"""Points this deep inside full coverage in every view lie in a thick organ: 3.5 px wide or more."""


@dataclass(frozen=True)
class Evidence:
    """Measured coverage of all views, or where roots are translucent their opacity, with the cameras."""

    bank: ViewBank
    silhouettes: tuple[Silhouette, ...]
    """In the order of the bank's views."""
    coverage: Any
    """mi.Float, (V, H, W) flattened: coverage, opacity where roots are translucent."""
    seen: Any
    """mi.Float, (V, H, W) flattened: 1 where the picture says something, else 0."""
    image_wh: tuple[int, int]
    mu_per_mm: float | None = None
    """Attenuation of the roots; None for opaque ones."""
    light: bool = False
    """Whether ``coverage`` is opacity, which comes with its noise; coverage comes without."""

    @staticmethod
    def of(bank: ViewBank, silhouettes: list[Silhouette]) -> Evidence:
        """Put silhouettes on the device."""
        height, width = silhouettes[0].coverage.shape
        coverage = numbers(np.concatenate([s.coverage.ravel() for s in silhouettes]))
        seen = numbers(np.concatenate([s.seen.ravel() for s in silhouettes]))
        return Evidence(bank, tuple(silhouettes), coverage, seen, (width, height))

    @property
    def has_opacity(self) -> bool:
        """Tell whether the pictures were of light, and not silhouettes from the beginning."""
        return all(silhouette.opacity is not None for silhouette in self.silhouettes)

    def by_light(self) -> Evidence:
        """Return the opacity of all views as the evidence, roots still taken for opaque.

        Raises
        ------
        ValueError
            Where the pictures were silhouettes from the beginning.
        """
        pictures = [s.opacity.ravel() for s in self.silhouettes if s.opacity is not None]
        if len(pictures) < len(self.silhouettes):
            raise ValueError(f"only {len(pictures)} of {len(self.silhouettes)} views have an opacity")
        return replace(self, coverage=numbers(np.concatenate(pictures)), light=True)

    def of_views(self, which: Sequence[int]) -> Evidence:
        """Return what some of the views say."""
        pixel = (np.asarray(which)[:, None] * self.pixels + np.arange(self.pixels)).ravel()
        coverage, seen = (dr.gather(mi.Float, part, wholes(pixel)) for part in (self.coverage, self.seen))
        dr.eval(coverage, seen)
        return replace(
            self, bank=self.bank.chosen(which), silhouettes=tuple(self.silhouettes[k] for k in which), coverage=coverage, seen=seen
        )

    @property
    def pixels(self) -> int:
        """Return the number of pixels of a view."""
        return self.image_wh[0] * self.image_wh[1]

    def project(self, points_mm: Array) -> Nodes:
        """Project points (N, 3) into all views."""
        views, count = self.bank.count, len(points_mm)
        point = mi.Point3f(*(numbers(np.tile(part, views)) for part in points_mm.T))
        view = wholes(np.repeat(np.arange(views), count))
        p = projection.project(self.bank, view, point, mi.Bool(True))
        dr.eval(p.px, p.du, p.dv, p.seen)  # one by one, each would be a projection of its own

        def gathered(*parts: Any) -> Array:
            return np.stack([np.array(part, np.float64).reshape(views, count) for part in parts], axis=-1)

        px, width, height = gathered(p.px.x, p.px.y), *self.image_wh
        seen = np.array(p.seen).reshape(views, count) & (px > 1.0).all(axis=-1) & (px < np.array([width, height]) - 2.0).all(axis=-1)
        return Nodes(px, gathered(p.du.x, p.du.y, p.du.z), gathered(p.dv.x, p.dv.y, p.dv.z), seen)


@dataclass(frozen=True)
class Nodes:
    """Where points lie in all views."""

    px: Array
    """(V, N, 2)"""
    du: Array
    """(V, N, 3) gradient of the column by the point, px/mm."""
    dv: Array
    """(V, N, 3) gradient of the row."""
    seen: NDArray[np.bool_]
    """(V, N)"""

    def across(self, normal: Array) -> Array:
        """Return the gradient (V, N, 3) of the position along image directions (V, N, 2), px/mm."""
        gradient: Array = normal[..., :1] * self.du + normal[..., 1:] * self.dv
        return gradient

    def view(self, view: int) -> Nodes:
        """Return the points in one view, (1, N)."""
        one = slice(view, view + 1)
        return Nodes(self.px[one], self.du[one], self.dv[one], self.seen[one])

    @cached_property
    def _ray(self) -> Array:
        """Unit directions (V, N, 3) of the lines of sight, along which no pixel changes."""
        ray = np.cross(self.du, self.dv)
        ray /= np.maximum(np.sqrt(np.einsum("vni,vni->vn", ray, ray)), 1e-12)[..., None]
        return np.asarray(ray)

    def sine(self, direction: Array, nodes: NDArray[np.int64] | slice = slice(None)) -> Array:
        """Return the sine (V, M) of the angle between a direction (M, 3) at some nodes (M,), all by default, and the lines of sight."""
        return np.asarray(np.sqrt(np.maximum(1.0 - np.einsum("vni,ni->vn", self._ray[:, nodes], direction) ** 2, 0.0)))


def generous_outline(silhouette: Silhouette) -> Image:
    """Return a signed distance (2 H, 2 W) in pixels to a generous outline, as `silhouettes.signed_distance` does to the best one.

    It is meant to hold every root, however thin, at the price of holding more.
    """
    blurred = cv2.GaussianBlur(silhouette.coverage, (0, 0), _TRACE_BLUR_PX)
    return _distance(silhouette, blurred, _TRACE) + np.float32(_TRACE_SLACK_PX)


def core_outline(silhouette: Silhouette) -> Image:
    """Return a signed distance (2 H, 2 W) in pixels, positive only deep inside full coverage."""
    return _distance(silhouette, silhouette.coverage, _FULL) - np.float32(CORE_PX)


def _distance(silhouette: Silhouette, picture: Image, level: float) -> Image:
    """Return the signed distance to where a picture crosses a level, to half a pixel; large where nothing is said."""
    size = (picture.shape[1] * UPSAMPLING, picture.shape[0] * UPSAMPLING)
    unseen = cv2.resize(silhouette.seen.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) == 0
    inside = ((cv2.resize(picture, size, interpolation=cv2.INTER_LINEAR) > level) | unseen).astype(np.uint8)
    depth, beyond = (cv2.distanceTransform(part, cv2.DIST_L2, 5) for part in (inside, 1 - inside))
    distance = ((depth - beyond) / UPSAMPLING).astype(np.float32)
    distance[cv2.dilate(unseen.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0] = UNSEEN_PX
    return distance


def bilinear(source: Any, base: Any, width: int, u: Any, v: Any, active: Any = True) -> Any:
    """Interpolate a flattened picture that begins at ``base``, of some width, at pixels inside of it."""
    column, row = mi.UInt32(u), mi.UInt32(v)
    fu, fv = u - mi.Float(column), v - mi.Float(row)
    at = base + row * width + column
    c00, c01, c10, c11 = (dr.gather(mi.Float, source, at + step, active) for step in (0, 1, width, width + 1))
    return (1 - fv) * ((1 - fu) * c00 + fu * c01) + fv * ((1 - fu) * c10 + fu * c11)
