"""Roots that the pictures show and the result lacks, and roots of the result that the pictures do not show."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from skimage.morphology import skeletonize

from rhizotwin.recon.coverage.silhouettes import Image, Mask
from rhizotwin.recon.optics import cameras
from rhizotwin.recon.optics.refraction import Optics
from rhizotwin.scenes.model import Scene
from rhizotwin.verification.pictures import Picture, smooth
from rhizotwin.verification.synthesis import Synthesis, true_camera

Array = NDArray[np.float64]
Numbers = NDArray[np.int64]

_NEAR_PX = 2
"""Distance, px, within which a root in a picture matches a rendered root, as in `rhizotwin score --pictures`."""
_SUPPORT = 2
"""Minimum number of views that must show the same structure. In the others, other roots may hide it."""
_LINK_PX = 4.0
"""Edge length of the cubes by which points are joined to structures, in pixels."""
_MOST_POINTS = 500_000
"""Maximum number of points on lines of sight that are tested for missing roots, to limit memory and time."""


@dataclass(frozen=True, kw_only=True)
class Structure:
    """Part of a root on which result and pictures disagree."""

    kind: Literal["missing", "surplus"]
    """Whether the result lacks the part, or the pictures do not show it."""
    length_mm: float
    """Visible length in the picture that shows most of it, mm."""
    centre_mm: tuple[float, float, float]
    """Centre of the part, mm, canister frame."""
    pixels: dict[str, tuple[float, float]]
    """Centre of the part in each picture that shows it, px, keyed by file name."""


@dataclass(frozen=True, eq=False)
class Comparison:
    """Differences between one picture and its rendered opacity."""

    picture: Picture
    rendered: Image
    """(H, W) rendered opacity, with the blur of the pictures."""
    missing: Mask
    """(H, W) pixels with a root in the picture, but none nearby in the rendering."""
    surplus: Mask
    """(H, W) pixels with a rendered root, but none nearby in the picture."""
    clear: Mask
    """(H, W) usable pixels far from all roots of the picture and the rendering."""
    explained: float
    """Fraction of the root pixels of the picture that the rendering explains. It is 1 if the picture shows no root."""
    mm_per_px: float
    """Scale of the picture at the roots, mm per pixel."""


def compare(picture: Picture, rendered: Image, mm_per_px: float) -> Comparison:
    """Compare a picture with its rendered opacity (H, W)."""
    level = picture.trace_level(rendered)
    shown = picture.smooth
    made = smooth(rendered, np.ones_like(picture.usable))
    seen = cv2.erode(picture.usable.astype(np.uint8), _disc()) > 0
    root = (shown > level) & seen
    near_made, near_shown = (cv2.dilate((image > 0.5 * level).astype(np.uint8), _disc()) > 0 for image in (made, shown))
    missing = root & ~near_made
    return Comparison(
        picture=picture,
        rendered=rendered,
        missing=missing,
        surplus=(made > level) & seen & ~near_shown,
        clear=seen & ~near_made & ~near_shown,
        explained=1.0 - float(missing.sum()) / max(1, int(root.sum())),
        mm_per_px=mm_per_px,
    )


def _disc() -> NDArray[np.uint8]:
    return cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * _NEAR_PX + 1,) * 2).astype(np.uint8)


def find_structures(compared: Sequence[Comparison], synthesis: Synthesis, scene: Scene, optics: Optics) -> tuple[Structure, ...]:
    """Locate missing and surplus structures in the canister frame, the longest ones first.

    Parameters
    ----------
    compared : sequence of Comparison
        Differences between the pictures and the rendered opacities.
    synthesis, scene : Synthesis, Scene
        Twin of the result, and scene of the dataset.
    optics : Optics
        Calibrated optics of the result, by which points are assigned to pixels.
    """
    if not compared:
        return ()
    missing = _missing_points(compared, synthesis, scene, optics)
    surplus = _surplus_points(compared, synthesis, scene)
    found = [*_join(compared, missing, "missing"), *_join(compared, surplus, "surplus")]
    return tuple(sorted(found, key=lambda one: -one.length_mm))


@dataclass(frozen=True)
class _Points:
    """Points of structures with their pixels in the views."""

    place_mm: Array
    """(N, 3) points, mm."""
    px: Numbers
    """(N, V, 2) nearest pixel in each view, or -1 where the view does not show the structure at this point."""


def _missing_points(compared: Sequence[Comparison], synthesis: Synthesis, scene: Scene, optics: Optics) -> _Points:
    """Return the points at which missing roots may be.

    At least `_SUPPORT` views, or all if there are fewer, must show a missing root, and none a clear background.
    """
    step_mm = _NEAR_PX * min(one.mm_per_px for one in compared)
    along_mm = np.arange(0.0, 2.0 * optics.inner_radius_mm, step_mm)
    points = []
    for one in compared:
        px = np.argwhere(one.missing)[:, ::-1]
        px = px[:: max(1, -(-len(px) * len(along_mm) * len(compared) // _MOST_POINTS))]
        rays = synthesis.rays(true_camera(one.picture.camera, scene), px)
        origin, direction = rays.origin_mm[rays.known], rays.direction[rays.known]
        points.append((origin[:, None] + along_mm[:, None] * direction[:, None]).reshape(-1, 3))
    place = np.concatenate(points)
    place = place[(np.hypot(place[:, 0], place[:, 1]) < optics.inner_radius_mm) & (place[:, 2] > optics.floor_z_mm)]
    place = place[place[:, 2] < optics.water_z_mm]
    px = np.full((len(place), len(compared), 2), -1, np.int64)
    for v, one in enumerate(compared):
        inside, at = _pixels(one, optics, place)
        wide = cv2.dilate(one.missing.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
        shows = inside & wide[at[:, 1], at[:, 0]]
        px[shows, v] = at[shows]
        stays = ~inside | shows | ~one.clear[at[:, 1], at[:, 0]]
        place, px = place[stays], px[stays]
    return _with_support(place, px)


def _surplus_points(compared: Sequence[Comparison], synthesis: Synthesis, scene: Scene) -> _Points:
    """Return the points of the shape that the pictures do not show."""
    places = [np.zeros((0, 3))]
    pixels = [np.zeros((0, len(compared), 2), np.int64)]
    for v, one in enumerate(compared):
        surface = synthesis.surface(true_camera(one.picture.camera, scene), one.rendered)
        px = np.argwhere(one.surplus & (surface.distance_px <= _NEAR_PX))[:, ::-1]
        here = np.full((len(px), len(compared), 2), -1)
        here[:, v] = px
        places.append(surface.at(px)[1])
        pixels.append(here)
    return _Points(np.concatenate(places), np.concatenate(pixels))


def _pixels(one: Comparison, optics: Optics, place_mm: Array) -> tuple[Mask, Numbers]:
    """Return whether a picture shows each point (N,), and the nearest pixels (N, 2), which are 0 otherwise."""
    height, width = one.missing.shape
    px = cameras.project_inner(one.picture.view, optics, place_mm)
    inside = np.asarray(np.isfinite(px).all(axis=1))
    near = np.where(inside[:, None], np.rint(np.where(inside[:, None], px, 0.0)), 0.0).astype(np.int64)
    inside &= (near >= 0).all(axis=1) & (near < (width, height)).all(axis=1)
    return inside, np.where(inside[:, None], near, 0)


def _with_support(place_mm: Array, px: Numbers) -> _Points:
    enough = (px[:, :, 0] >= 0).sum(axis=1) >= min(_SUPPORT, px.shape[1])
    return _Points(place_mm[enough], px[enough])


def _join(compared: Sequence[Comparison], points: _Points, kind: Literal["missing", "surplus"]) -> list[Structure]:
    """Join neighbouring points to structures that enough views show."""
    if not len(points.place_mm):
        return []
    edge_mm = _LINK_PX * min(one.mm_per_px for one in compared)
    cell = np.floor(points.place_mm / edge_mm).astype(np.int64)
    cell -= cell.min(axis=0) - 1
    grid = np.zeros(cell.max(axis=0) + 2, bool)
    grid[tuple(cell.T)] = True
    number = ndimage.label(grid, np.ones((3, 3, 3)))[0][tuple(cell.T)]
    order = np.argsort(number, kind="stable")
    parts = np.split(order, np.flatnonzero(np.diff(number[order])) + 1)
    enough = min(_SUPPORT, len(compared))
    claimed = [np.zeros(one.missing.shape, bool) for one in compared]
    found = []
    for part in sorted(parts, key=lambda part: (-_views(points.px[part]), -len(part))):
        structure = _measure(compared, points.place_mm[part], points.px[part], claimed, kind)
        if len(structure.pixels) >= enough:
            found.append(structure)
    return found


def _views(px: Numbers) -> int:
    """Return the number of views that show some points (N, V, 2)."""
    return int((px[:, :, 0] >= 0).any(axis=0).sum())


def _measure(
    compared: Sequence[Comparison], place_mm: Array, px: Numbers, claimed: Sequence[Mask], kind: Literal["missing", "surplus"]
) -> Structure:
    """Measure the length of a structure in the picture that shows most of it.

    Its pixels are added to the masks ``claimed`` of all views, and do not count for later structures: where lines of
    sight of two pictures meet by chance, their pixels usually belong to a structure that more pictures show.
    """
    pixels = {}
    length_mm = 0.0
    for one, own, at in zip(compared, claimed, px.transpose(1, 0, 2), strict=True):
        there = at[at[:, 0] >= 0]
        there = there[~own[there[:, 1], there[:, 0]]]
        if not len(there):
            continue
        shape = np.zeros(one.missing.shape, np.uint8)
        shape[there[:, 1], there[:, 0]] = 1
        own |= cv2.dilate(shape, _disc()) > 0
        shape = cv2.morphologyEx(shape, cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
        length_mm = max(length_mm, line_length_px(shape > 0) * one.mm_per_px)
        x, y = there.mean(axis=0)
        pixels[one.picture.camera.file] = (float(x), float(y))
    x_mm, y_mm, z_mm = (float(value) for value in np.median(place_mm, axis=0))
    return Structure(kind=kind, length_mm=length_mm, centre_mm=(x_mm, y_mm, z_mm), pixels=pixels)


def line_length_px(area: Mask) -> float:
    """Return the length of the centre lines of an area (H, W), in pixels, without the gain of diagonal steps."""
    return float(skeletonize(area).sum())
