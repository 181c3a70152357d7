"""Dirt on the canister's outside, told from the roots inside by parallax.

Dust, scratches and the seam of a rolled tube turn with the wall and look like roots that no other view confirms. Seen
over the turn and unrolled, each face of the wall is in focus where its own dirt is: what is on the outside is dark in
its place in all views, and from view to view somewhere else on the inside, by the way of light through the wall. So no
shape has to be assumed, and roots that grow along the inside stay. What such dirt covers is not seen.
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
"""Opacity of what is no noise: as what is asked of a faint root."""
_WIDEST_MM = 3.0
"""Seams are 1 to 2 mm wide. What is wider is not looked at: a thick root is dark in many views of a place, too."""
_ALWAYS = 0.85
"""Share of the views of a place in which it is dark: one in seven may look past it by poses and rounding. Elsewhere on
the wall of a scan of 1.6 m of roots the share was 0.1 to 0.4."""
_SHARPER = 0.15
"""By how much larger that share is than on the inside: of dust 0.6 and more, of nearly level scratches 0.3; of what is
on the inside it is less than 0."""
_STEEPEST = 0.2
"""Slope in the water of lines of sight from a camera 16 degrees above or below."""
_AT_ONCE = 8
"""Views whose maps are kept at once."""
_ABOUT = 15
"""Edge, in texels, of a place's surroundings: their median is not that of a scratch or a seam of 4 mm."""
_LEAST_SHARE = 0.02
"""Share of views in which anything darkens a place, at least: noise does."""
_NEVER = 10.0
"""A tenth of a texel is dark by chance on the whole wall."""
_LEAST_VIEWS = 5
"""At top and bottom only views from near see a place, a sixth of a ring."""


def face_of(optics: Optics, px_a_mm: float) -> Face:
    """Unroll the outside in texels of about a pixel, as far as lines of sight pass it."""
    return Face(1.0 / px_a_mm, outside=True, beyond_mm=_STEEPEST * 2.0 * optics.outer_radius_mm)


def find(opacity: dict[int, Image], seen: dict[int, Mask], views: dict[int, View], optics: Optics, face: Face, monitor: Monitor) -> Mask:
    """Find the dirt on the outside of the wall.

    Parameters
    ----------
    opacity : dict of (H, W) float32 array
        One less image over backlight, by number of the frame; without films.
    seen : dict of (H, W) bool array
        Where it says something.
    views, optics : dict of View, Optics
        Cameras, and the canister.
    face : Face
        The outside, as `face_of` unrolls it.
    monitor : Monitor
        Hears of every view.

    Returns
    -------
    (rows, columns) bool array
        Texels of the outside that are dirty, with one about them.
    """
    share, counted = {}, {}
    for outside in (False, True):
        unrolled = replace(face, outside=outside)
        size = unrolled.shape(optics)
        dark, number = np.zeros(size, np.float32), np.zeros(size, np.float32)
        keys = list(opacity)
        for some in (keys[i : i + _AT_ONCE] for i in range(0, len(keys), _AT_ONCE)):  # all together would fill the memory
            for part, of_view in monitor.each(partial(_marked, opacity, seen, views, optics, unrolled), "outside", some):
                dark += part
                number += of_view
        counted[outside] = number
        share[outside] = np.where(number >= _LEAST_VIEWS, dark / np.maximum(number, 1.0), 0.0).astype(np.float32)
    rows, columns = share[True].shape
    inside = cv2.resize(share[False], (columns, rows), interpolation=cv2.INTER_LINEAR)  # at the same azimuths
    likely = (share[True] > _ALWAYS) & (share[True] > inside + _SHARPER)
    label, _ = ndimage.label(likely, structure=np.ones((3, 3), bool))
    sure = np.unique(label[likely & ~_by_chance(share[True], counted[True])])
    dirty = likely & np.isin(label, sure)  # a seam goes on before a crowd
    ringed = np.concatenate([dirty[:, -1:], dirty, dirty[:, :1]], axis=1)
    return np.asarray(ndimage.binary_dilation(ringed, np.ones((3, 3), bool))[:, 1:-1])


def _by_chance(share: Image, number: Image) -> Mask:
    """Tell the texels (rows, columns) that roots may have darkened in so many of the views that see them.

    Roots darken a place as often as those about it, and at least as often as the mean place, with the share p. By
    chance it is dark in the share q of n views with a probability of at most exp(-n (q log(q / p) + (1 - q) log((1 -
    q) / (1 - p)))) (Chernoff's bound), and on the whole wall that must not happen.
    """
    about = cv2.medianBlur(np.round(255.0 * share).astype(np.uint8), _ABOUT) / 255.0
    told = number >= _LEAST_VIEWS
    mean = float(share[told].mean()) if told.any() else 0.0
    p, q = np.clip(about, max(mean, _LEAST_SHARE), 1.0), np.clip(share, 1e-6, 1.0 - 1e-6)
    rare = number * (q * np.log(q / p) + (1.0 - q) * np.log((1.0 - q) / np.maximum(1.0 - p, 1e-6)))
    return np.asarray((rare < np.log(_NEVER * share.size)) | (q < p))


def _marked(
    opacity: dict[int, Image], seen: dict[int, Mask], views: dict[int, View], optics: Optics, face: Face, k: int
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return which texels (rows, columns) are dark in a view, as a share of its pixels there, and which it sees.

    From near and from far are two views.
    """
    rows, columns = face.shape(optics)
    wide = _wide(opacity[k], face)
    # a pixel to each side: what is smaller than one moves between them
    dark = cv2.dilate(opacity[k], np.ones((3, 3), np.uint8)) > _DARK
    at = wall.crossings(views[k], optics, face)
    share, sees = np.zeros(rows * columns, np.float32), np.zeros(rows * columns, np.float32)
    for column, row in zip(at.column, at.row, strict=True):
        nearest = np.rint(row).astype(np.int32)
        here = seen[k] & ~wide & (nearest >= 0) & (nearest < rows)
        texel = nearest[here] * columns + np.mod(np.rint(column[here]).astype(np.int32), columns)
        number = np.bincount(texel, minlength=rows * columns)
        share += np.bincount(texel, weights=dark[here], minlength=rows * columns) / np.maximum(number, 1)
        sees += number > 0
    return share.reshape(rows, columns), sees.reshape(rows, columns)


def hidden(opacity: Image, dirty: Mask, where: Crossings, face: Face) -> Mask:
    """Return the pixels (H, W) that dirt on the outside hides, near or far.

    Before a thick root it changes nothing.

    Parameters
    ----------
    opacity : (H, W) float32 array
        Of the picture.
    dirty : (rows, columns) bool array
        Texels of the outside.
    where, face : Crossings, Face
        Where lines of sight pass it.
    """
    return np.asarray((wall.passed(dirty.astype(np.float32), where) >= 0.5) & ~_wide(opacity, face))


def _wide(opacity: Image, face: Face) -> Mask:
    """Tell the pixels (H, W) of what is wider than dirt."""
    edge = 2 * round(0.5 * _WIDEST_MM / face.texel_mm) + 1
    return np.asarray(cv2.morphologyEx(opacity, cv2.MORPH_OPEN, np.ones((edge, edge), np.uint8)) > _DARK)
