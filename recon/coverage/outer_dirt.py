"""Dirt on the outside of the canister, separated from the roots inside by parallax.

Dust, scratches and the seam of a rolled tube rotate with the wall and look like roots, but no other view confirms them.
When all views are unrolled onto one face of the wall, dirt on that face is at the same place in all of them, while on
the other face it moves from view to view by the path of light through the wall. No assumption about the shape is
needed, and roots along the inside remain. Pixels covered by such dirt are not usable.
"""

from __future__ import annotations

from dataclasses import replace
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
"""Minimum opacity of dirt, above the noise, as for a faint root."""
_WIDEST_MM = 3.0
"""Maximum width of dirt; seams are 1 to 2 mm wide. Wider objects are ignored: a thick root is also dark in many
views."""
_ALWAYS = 0.85
"""Minimum fraction of the views of a place in which it is dark: one in seven may miss it due to pose errors and
rounding. Elsewhere on the wall of a scan of 1.6 m of roots, the fraction was 0.1 to 0.4."""
_SHARPER = 0.15
"""Minimum difference of this fraction between outside and inside: dust has 0.6 and more, nearly level scratches 0.3,
and objects on the inside have less than 0."""
_STEEPEST = 0.2
"""Maximum slope, in the water, of lines of sight from a camera 16 degrees above or below."""
_AT_ONCE = 8
"""Number of views whose maps are kept at once."""
_ABOUT = 15
"""Edge, in texels, of a place's surroundings: their median is not affected by a scratch or a seam of 4 mm."""
_LEAST_SHARE = 0.02
"""Minimum fraction of views in which a place is dark, due to noise."""
_NEVER = 10.0
"""Expected number of texels on the whole wall that are dark by chance, as its inverse: 0.1 texels."""
_LEAST_VIEWS = 5
"""Minimum number of views: at top and bottom, only views from near show a place, a sixth of a ring."""


def outer_face(optics: Optics, px_a_mm: float) -> Face:
    """Return the outside in texels of about one pixel, as far up and down as lines of sight cross it."""
    return Face(1.0 / px_a_mm, outside=True, beyond_mm=_STEEPEST * 2.0 * optics.outer_radius_mm)


def detect_dirt(
    opacity: dict[int, Image], usable: dict[int, Mask], views: dict[int, View], optics: Optics, face: Face, monitor: Monitor
) -> Mask:
    """Detect dirt on the outside of the wall.

    Parameters
    ----------
    opacity : dict of (H, W) float32 array
        1 - image / backlight, by frame number; without films.
    usable : dict of (H, W) bool array
        Masks of usable pixels.
    views, optics : dict of View, Optics
        Cameras and canister.
    face : Face
        The outside, as returned by `outer_face`.
    monitor : Monitor
        Receives the progress, per view.

    Returns
    -------
    (rows, columns) bool array
        Mask of dirty texels of the outside, dilated by one.
    """
    share, counted = {}, {}
    for outside in (False, True):
        unrolled = replace(face, outside=outside)
        size = unrolled.shape(optics)
        dark, number = np.zeros(size, np.float32), np.zeros(size, np.float32)
        keys = list(opacity)
        for some in (keys[i : i + _AT_ONCE] for i in range(0, len(keys), _AT_ONCE)):  # in groups, to limit memory
            for part, of_view in monitor.each(partial(_dark_texels, opacity, usable, views, optics, unrolled), "outside", some):
                dark += part
                number += of_view
        counted[outside] = number
        share[outside] = np.where(number >= _LEAST_VIEWS, dark / np.maximum(number, 1.0), 0.0).astype(np.float32)
    rows, columns = share[True].shape
    inside = cv2.resize(share[False], (columns, rows), interpolation=cv2.INTER_LINEAR)  # at the same azimuths
    likely = (share[True] > _ALWAYS) & (share[True] > inside + _SHARPER)
    label, _ = ndimage.label(likely, structure=np.ones((3, 3), bool))
    sure = np.unique(label[likely & ~_chance_texels(share[True], counted[True])])
    dirty = likely & np.isin(label, sure)  # a seam continues in front of a cluster
    ringed = np.concatenate([dirty[:, -1:], dirty, dirty[:, :1]], axis=1)
    return np.asarray(ndimage.binary_dilation(ringed, np.ones((3, 3), bool))[:, 1:-1])


def _chance_texels(share: Image, number: Image) -> Mask:
    """Return the texels (rows, columns) that may be dark in the observed number of views by chance, due to roots.

    Roots darken a place as often as its surroundings, and at least as often as the mean place, with probability p. The
    probability that it is dark in a fraction q of n views is at most exp(-n (q log(q / p) + (1 - q) log((1 - q) / (1 -
    p)))) (Chernoff bound); it must be small for the whole wall.
    """
    about = cv2.medianBlur(np.round(255.0 * share).astype(np.uint8), _ABOUT) / 255.0
    enough = number >= _LEAST_VIEWS
    mean = float(share[enough].mean()) if enough.any() else 0.0
    p, q = np.clip(about, max(mean, _LEAST_SHARE), 1.0), np.clip(share, 1e-6, 1.0 - 1e-6)
    rare = number * (q * np.log(q / p) + (1.0 - q) * np.log((1.0 - q) / np.maximum(1.0 - p, 1e-6)))
    return np.asarray((rare < np.log(_NEVER * share.size)) | (q < p))


def _dark_texels(
    opacity: dict[int, Image], usable: dict[int, Mask], views: dict[int, View], optics: Optics, face: Face, k: int
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the dark fraction of each texel's pixels (rows, columns) in a view, and whether the view shows it.

    The near and the far wall count as two views.
    """
    rows, columns = face.shape(optics)
    wide = _wide_objects(opacity[k], face)
    # Dilate by one pixel: smaller objects move between pixels.
    dark = cv2.dilate(opacity[k], np.ones((3, 3), np.uint8)) > _DARK
    at = wall.crossings(views[k], optics, face)
    share, sees = np.zeros(rows * columns, np.float32), np.zeros(rows * columns, np.float32)
    for column, row in zip(at.column, at.row, strict=True):
        nearest = np.rint(row).astype(np.int32)
        here = usable[k] & ~wide & (nearest >= 0) & (nearest < rows)
        texel = nearest[here] * columns + np.mod(np.rint(column[here]).astype(np.int32), columns)
        number = np.bincount(texel, minlength=rows * columns)
        share += np.bincount(texel, weights=dark[here], minlength=rows * columns) / np.maximum(number, 1)
        sees += number > 0
    return share.reshape(rows, columns), sees.reshape(rows, columns)


def hidden_pixels(opacity: Image, dirty: Mask, where: Crossings, face: Face) -> Mask:
    """Return the pixels (H, W) that dirt on the outside hides, on the near or far wall.

    Pixels in front of a thick root are not affected.

    Parameters
    ----------
    opacity : (H, W) float32 array
        Opacity of the picture.
    dirty : (rows, columns) bool array
        Mask of dirty texels of the outside.
    where, face : Crossings, Face
        Crossings of the lines of sight with the outside.
    """
    return np.asarray((wall.sum_crossings(dirty.astype(np.float32), where) >= 0.5) & ~_wide_objects(opacity, face))


def _wide_objects(opacity: Image, face: Face) -> Mask:
    """Return the pixels (H, W) of objects wider than dirt."""
    edge = 2 * round(0.5 * _WIDEST_MM / face.texel_mm) + 1
    return np.asarray(cv2.morphologyEx(opacity, cv2.MORPH_OPEN, np.ones((edge, edge), np.uint8)) > _DARK)
