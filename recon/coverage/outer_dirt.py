"""Dirt on the outside of the canister, distinguished from the roots inside by parallax.

Dust, scratches and the seam of a rolled tube rotate with the wall and resemble roots, but other views do not confirm
them as roots. When all views are unrolled onto the outer face of the wall, dirt on this face is at the same position in
all views. Unrolled onto the inner face, the dirt moves between the views, due to the path of the light through the
wall. The method does not depend on the shape of the dirt, and roots along the inside of the wall are retained. Pixels
covered by dirt are not usable.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from rhizotwin.recon.coverage import wall
from rhizotwin.recon.coverage.silhouettes import Image, Mask
from rhizotwin.recon.coverage.wall import Crossings, Face
from rhizotwin.recon.optics.cameras import View
from rhizotwin.recon.optics.refraction import Optics
from rhizotwin.scenes.monitor import Monitor

_DARK = 0.08
"""Opacity above which a pixel may show dirt. It is above the noise, and similar to the opacity of a faint root."""
_WIDEST_MM = 3.0
"""Maximum width of dirt, mm. Seams are 1 to 2 mm wide. Wider objects are ignored, because thick roots are also dark in
many views."""
_ALWAYS = 0.85
"""Fraction of the views of a texel in which it must be dark to be classified as dirt. One view in seven may miss the
dirt due to pose errors and rounding. Elsewhere on the wall, the fraction was 0.1 to 0.4 in a scan with 1.6 m of
roots."""
_SHARPER = 0.15
"""Minimum difference between two fractions for a texel to be classified as dirt. They are the fraction of views in
which the texel is dark on the outer face, and the corresponding fraction on the inner face. The difference is 0.6 or
more for dust, 0.3 for nearly horizontal scratches, and negative for objects on the inside."""
_STEEPEST = 0.2
"""Maximum slope of lines of sight in the water, for a camera 16 degrees above or below the horizontal."""
_COARSEST_MM = 0.2
"""Maximum size of averaged pixels, mm. An opaque speck of half this diameter makes such a pixel twice as dark as
`_DARK`."""
_AT_ONCE = 8
"""Number of views that are unrolled at once."""
_ABOUT = 15
"""Side, in texels, of the square whose median represents the surroundings of a texel. A scratch, or a seam of 4 mm,
does not affect this median."""
_LEAST_SHARE = 0.02
"""Lower limit of the probability with which a texel is assumed to be dark in a view by chance. It accounts for
noise."""
_NEVER = 10.0
"""Inverse of the number of texels on the whole wall that may be classified as dirt by chance. The value corresponds to
an expected number of 0.1 texels."""


def outer_face(optics: Optics, px_a_mm: float) -> Face:
    """Return the outer face of the wall, with texels of about one pixel, or of several averaged pixels.

    The face extends above and below the water as far as lines of sight through the water cross it.

    Parameters
    ----------
    optics : Optics
        Optics of the canister.
    px_a_mm : float
        Scale of the pictures at the canister's axis, px/mm.
    """
    halvings = np.clip(np.floor(np.log2(_COARSEST_MM * px_a_mm)), 0, np.log2(wall.STEP))
    shrink = 2 ** int(halvings)
    return Face(shrink / px_a_mm, outside=True, beyond_mm=_STEEPEST * 2.0 * optics.outer_radius_mm, shrink=shrink)


def detect_dirt(
    opacity: dict[int, Image], usable: dict[int, Mask], views: dict[int, View], optics: Optics, face: Face, monitor: Monitor
) -> Mask:
    """Detect dirt on the outside of the wall.

    Parameters
    ----------
    opacity : dict of (H, W) float32 array
        1 - picture / backlight, without films, keyed by frame number.
    usable : dict of (H, W) bool array
        Masks of usable pixels, keyed by frame number.
    views, optics : dict of View, Optics
        Cameras, keyed by frame number, and optics of the canister.
    face : Face
        Outer face of the wall, as returned by `outer_face`.
    monitor : Monitor
        Receives progress messages for each view.

    Returns
    -------
    (rows, columns) bool array
        Mask of dirty texels on the outer face, dilated by one texel.
    """
    faces, keys = [replace(face, outside=outside) for outside in (False, True)], list(opacity)
    darks, numbers = ([np.zeros(each.shape(optics), np.float32) for each in faces] for _ in range(2))
    for some in (keys[i : i + _AT_ONCE] for i in range(0, len(keys), _AT_ONCE)):  # in groups, to limit memory
        for of_faces in monitor.each(partial(_dark_texels, opacity, usable, views, optics, faces), "outside", some):
            for dark, number, patches in zip(darks, numbers, of_faces, strict=True):
                for patch in patches:
                    dark[patch.rows, patch.columns] += patch.dark
                    number[patch.rows, patch.columns] += patch.shown
    inner, outer = (
        np.where(number >= wall.LEAST_VIEWS, dark / np.maximum(number, 1.0), 0.0).astype(np.float32)
        for dark, number in zip(darks, numbers, strict=True)
    )
    rows, columns = outer.shape
    inside = cv2.resize(inner, (columns, rows), interpolation=cv2.INTER_LINEAR)  # at the same azimuths
    likely = (outer > _ALWAYS) & (outer > inside + _SHARPER)
    label, _ = ndimage.label(likely, structure=np.ones((3, 3), bool))
    sure = np.unique(label[likely & ~_chance_texels(outer, numbers[1])])
    dirty = likely & np.isin(label, sure)  # includes the parts of a seam in front of a cluster
    return np.asarray(ndimage.maximum_filter(dirty, 3, mode=("constant", "wrap")))


def _chance_texels(share: Image, number: Image) -> Mask:
    """Return the texels (rows, columns) that roots may darken by chance in as many views as observed.

    The probability p that roots darken a texel in a view is assumed to be that of its surroundings, and at least the
    mean over the wall. The probability that the texel is dark in a fraction q of n views is then at most exp(-n (q
    log(q / p) + (1 - q) log((1 - q) / (1 - p)))) (Chernoff bound). Dirt is detected only if this bound is small for the
    whole wall.
    """
    about = cv2.medianBlur(np.round(255.0 * share).astype(np.uint8), _ABOUT) / 255.0
    enough = number >= wall.LEAST_VIEWS
    mean = float(share[enough].mean()) if enough.any() else 0.0
    p, q = np.clip(about, max(mean, _LEAST_SHARE), 1.0), np.clip(share, 1e-6, 1.0 - 1e-6)
    rare = number * (q * np.log(q / p) + (1.0 - q) * np.log((1.0 - q) / np.maximum(1.0 - p, 1e-6)))
    return np.asarray((rare < np.log(_NEVER * share.size)) | (q < p))


@dataclass(frozen=True)
class _Patch:
    """Texels of one face that a view shows on the near or on the far wall."""

    rows: slice
    columns: NDArray[np.intp]
    """(w,) columns of the texels, which may continue at the first column of the face."""
    dark: NDArray[np.float32]
    """(h, w) fraction of dark pixels in each texel."""
    shown: Mask
    """(h, w) mask of texels that contain a usable pixel."""

    @staticmethod
    def count(column: Image, row: Image, usable: Mask, dark: Mask, shape: tuple[int, int]) -> _Patch:
        """Count the pixels (H, W) in each texel, from their texel coordinates."""
        rows, columns = shape
        nearest = np.rint(row)
        here = np.flatnonzero(usable & (nearest >= 0) & (nearest < rows))
        if not len(here):
            return _Patch(slice(0), np.zeros(0, np.intp), np.zeros((0, 0), np.float32), np.zeros((0, 0), bool))
        v, u = nearest.ravel()[here].astype(np.intp), np.rint(column.ravel()[here]).astype(np.intp)
        top, left = v.min(), u.min()
        height, width = int(v.max() - top + 1), int(u.max() - left + 1)
        texel = (v - top) * width + (u - left)
        number = np.bincount(texel, minlength=height * width)
        count = np.bincount(texel[dark.ravel()[here]], minlength=height * width)
        share = (count / np.maximum(number, 1)).astype(np.float32).reshape(height, width)
        return _Patch(
            slice(int(top), int(top) + height), np.mod(np.arange(left, left + width), columns), share, (number > 0).reshape(height, width)
        )


def _dark_texels(
    opacity: dict[int, Image],
    usable: dict[int, Mask],
    views: dict[int, View],
    optics: Optics,
    faces: Sequence[Face],
    k: int,
) -> list[list[_Patch]]:
    """Return the dark texels of each face in a view, on the near wall and on the far wall.

    If a view shows a texel on both walls, it counts as two views.
    """
    small, seen = (_reduce(part, faces[0].shrink) for part in (opacity[k], usable[k].astype(np.float32)))
    seen = (seen == 1.0) & ~_wide_objects(small, faces[0])
    # Dilate by one pixel: smaller objects move between pixels.
    dark = cv2.dilate(small, np.ones((3, 3), np.uint8)) > _DARK
    found = []
    for face in faces:
        sides = wall.crossings(views[k], optics, face).sides
        found.append([_Patch.count(column, row, seen, dark, face.shape(optics)) for column, row in sides])
    return found


def hidden_pixels(opacity: Image, dirty: Mask, where: Crossings, face: Face) -> Mask:
    """Return the pixels (H, W) that are hidden by dirt on the near or far outer wall.

    Pixels in front of a thick root are not included.

    Parameters
    ----------
    opacity : (H, W) float32 array
        Opacity of the picture.
    dirty : (rows, columns) bool array
        Mask of dirty texels on the outer face.
    where, face : Crossings, Face
        Crossings of the lines of sight with the outer face, and the face.
    """
    hidden = wall.sum_crossings(dirty.astype(np.float32), where) >= 0.5
    hidden &= ~_wide_objects(_reduce(opacity, face.shrink), face)
    return np.kron(hidden, np.ones((face.shrink, face.shrink), bool))[: opacity.shape[0], : opacity.shape[1]]


def _reduce(picture: Image, shrink: int) -> Image:
    """Return the means of ``shrink`` x ``shrink`` pixels. The picture is extended by its last row and column."""
    if shrink == 1:
        return picture
    padded = np.pad(picture, [(0, -size % shrink) for size in picture.shape], mode="edge")
    return np.asarray(cv2.resize(padded, None, fx=1.0 / shrink, fy=1.0 / shrink, interpolation=cv2.INTER_AREA))


def _wide_objects(opacity: Image, face: Face) -> Mask:
    """Return the mask (H, W) of objects that are wider than dirt."""
    edge = 2 * round(0.5 * _WIDEST_MM / face.texel_mm) + 1
    return np.asarray(cv2.morphologyEx(opacity, cv2.MORPH_OPEN, np.ones((edge, edge), np.uint8)) > _DARK)
