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
_LEAST_VIEWS = 5
"""Of fewer views of a place two might be chance; at top and bottom only those from near see it, a sixth of a ring."""


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
    share = {}
    for outside in (False, True):
        unrolled = replace(face, outside=outside)
        size = unrolled.shape(optics)
        dark, number = np.zeros(size, np.float32), np.zeros(size, np.float32)
        keys = list(opacity)
        for some in (keys[i : i + _AT_ONCE] for i in range(0, len(keys), _AT_ONCE)):  # all together would fill the memory
            for part, of_view in monitor.each(partial(_marked, opacity, seen, views, optics, unrolled), "outside", some):
                dark += part
                number += of_view
        share[outside] = np.where(number >= _LEAST_VIEWS, dark / np.maximum(number, 1.0), 0.0).astype(np.float32)
    rows, columns = share[True].shape
    inside = cv2.resize(share[False], (columns, rows), interpolation=cv2.INTER_LINEAR)  # at the same azimuths
    dirty = (share[True] > _ALWAYS) & (share[True] > inside + _SHARPER)
    ringed = np.concatenate([dirty[:, -1:], dirty, dirty[:, :1]], axis=1)
    return np.asarray(ndimage.binary_dilation(ringed, np.ones((3, 3), bool))[:, 1:-1])


def _marked(
    opacity: dict[int, Image], seen: dict[int, Mask], views: dict[int, View], optics: Optics, face: Face, k: int
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return which texels (rows, columns) are dark in a view, as a share of its pixels there, and which it sees.

    From near and from far are two views.
    """
    rows, columns = face.shape(optics)
    # a pixel to each side: what is smaller than one moves between them
    dark = cv2.dilate(opacity[k], np.ones((3, 3), np.uint8)) > _DARK
    at = wall.crossings(views[k], optics, face)
    share, sees = np.zeros(rows * columns, np.float32), np.zeros(rows * columns, np.float32)
    for column, row in zip(at.column, at.row, strict=True):
        nearest = np.rint(row).astype(np.int32)
        here = seen[k] & (nearest >= 0) & (nearest < rows)
        texel = nearest[here] * columns + np.mod(np.rint(column[here]).astype(np.int32), columns)
        number = np.bincount(texel, minlength=rows * columns)
        share += np.bincount(texel, weights=dark[here], minlength=rows * columns) / np.maximum(number, 1)
        sees += number > 0
    return share.reshape(rows, columns), sees.reshape(rows, columns)


def hidden(dirty: Mask, where: Crossings) -> Mask:
    """Return the pixels (H, W) whose lines of sight pass dirt (rows, columns) on the outside, near or far."""
    sides = zip(where.column, where.row, strict=True)
    return np.asarray(sum(wall.look_up(dirty.astype(np.float32), *at) for at in sides) >= 0.5)
