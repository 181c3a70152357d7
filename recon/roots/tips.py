"""Location of root tips from the edge of the coverage along their axes.

Profiles across a tube do not constrain its end. Along the axis of a tip, the measured coverage m and the explained
coverage e decrease from the coverage c of the root to zero. The edge of m lies beyond the edge of e by

    integral of (m - e) / c

independently of the blur: pixels, blur, taper, the rounded end and neighbouring roots affect both edges equally. The
median over the views is used, since roots that are not modelled may hide a tip in some views.
"""

from __future__ import annotations

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.coverage.evidence import Evidence
from rhizotwin.recon.device import Kernel, bilinear, wholes
from rhizotwin.recon.tubes import tube_picture, tubes
from rhizotwin.recon.tubes.tubes import SPACING_MM, TANGENT_NODES, Tubes
from rhizotwin.scenes import polyline

Array = NDArray[np.float64]

_SAMPLES = 33
"""Number of samples along the axis of a tip. For a root with a radius of two pixels, there are three samples per
pixel."""
_REACH_PX = 3.0
"""Length that is sampled along the axis on each side of the last node, in addition to the radius, px. It covers the
blur of the edge and two cells of the search space."""
_LEAST_COVERAGE = 0.15
"""Minimum coverage of a root on its own axis, which corresponds to a width of a sixth of a pixel. Thinner roots show no
edge."""
_OTHERS = 0.1
"""Maximum coverage by other roots beyond a tip. A view with higher coverage is not used to locate the tip."""
_LEAST_SINE = 0.5
"""Minimum sine of the angle between a root's axis and the line of sight for a view to be used to locate the tip. At
smaller angles, a view shows the flank of a tip before its end."""
_LEAST_VIEWS = 4
"""Minimum number of usable views for a tip to be moved. In fewer views, the same root may disturb all measurements."""
_AT_ONCE = 2_000_000
"""Approximate number of samples in all views that are processed at once, to limit memory. One takes about 100 bytes."""
_LEAST_LENGTH = 0.5
"""Minimum length of an end after shortening, as a fraction of its former length. Shortening never removes an end."""


def place_tips(evidence: Evidence, tree: Tubes, px_a_mm: float) -> Tubes:
    """Move the tips of a tree along their axes to their position in the pictures.

    Parameters
    ----------
    evidence : Evidence
        Measured coverage, including taproot and hypocotyl.
    px_a_mm : float
        Image scale at the centre of the water, px/mm.
    """
    off_mm = _tip_offsets(evidence, tree, px_a_mm)
    centre = tree.centre_mm.copy()
    for line, move in zip(tree.ends, off_mm, strict=True):
        centre[line] = _stretch(tree.centre_mm[line], float(move))
    return tubes.with_geometry(tree, centre, tree.radius_mm)


def _tip_offsets(evidence: Evidence, tree: Tubes, px_a_mm: float) -> Array:
    """Return the distance (T,) of each tip beyond the last node of its branch, mm.

    It is 0 for tips with too few usable views.
    """
    tip = np.array([nodes[-1] for nodes in tree.branches])
    before = np.array([nodes[max(len(nodes) - 1 - TANGENT_NODES, 0)] for nodes in tree.branches])
    axis = polyline.unit_vectors(tree.centre_mm[tip] - tree.centre_mm[before])
    explained = 1.0 - tube_picture.transmittance(evidence, tree, tube_picture.project_axes(evidence, tree))
    dr.eval(explained)
    count = max(1, _AT_ONCE // (evidence.bank.count * _SAMPLES))
    parts = np.split(np.arange(len(tip)), np.arange(count, len(tip), count))
    found = [_measure_offsets(evidence, explained, tree.centre_mm[tip[k]], axis[k], tree.radius_mm[tip[k]], px_a_mm) for k in parts]
    return np.concatenate(found)


def _measure_offsets(evidence: Evidence, explained_there: Kernel, tip_mm: Array, axis: Array, radius: Array, px_a_mm: float) -> Array:
    """Return the distance (T,) of tips beyond given nodes, mm, as `_tip_offsets` does.

    Parameters
    ----------
    explained_there : mi.Float
        Coverage by the tubes in all views, flattened (V, H, W).
    tip_mm, axis, radius : (T, 3), (T, 3) and (T,) float64 array
        Last nodes, mm, unit vectors along their branches, and radii, mm.
    """
    reach = radius + _REACH_PX / px_a_mm
    way = reach[:, None] * np.linspace(-1.0, 1.0, _SAMPLES)  # (T, S)
    point = tip_mm[:, None] + way[..., None] * axis[:, None]
    at = evidence.project(point.reshape(-1, 3))
    views, p = at.shape[0], at.on_device
    start = wholes(np.repeat(np.arange(views), at.shape[1]) * evidence.pixels)
    measured, explained, usable = (
        np.array(bilinear(picture, start, evidence.size[0], p.px.x, p.px.y, p.visible)).reshape(views, *way.shape)
        for picture in (evidence.opacity, explained_there, evidence.usable)
    )
    clear = (at.visible.reshape(usable.shape) & (usable > 0.99)).all(axis=2)
    clear &= np.where(way > (radius + 0.5 * _REACH_PX / px_a_mm)[:, None], explained, 0.0).max(axis=2) < _OTHERS
    clear &= at.sine(np.repeat(axis, _SAMPLES, axis=0)).reshape(usable.shape)[:, :, 0] > _LEAST_SINE
    inner = way < -0.5 * reach[:, None]
    own = np.where(inner, explained, 0.0).sum(axis=2) / inner.sum(axis=1)
    clear &= own > _LEAST_COVERAGE
    more = 2.0 * reach * (measured - explained).mean(axis=2) / np.maximum(own, _LEAST_COVERAGE)
    off = np.where(clear, more, np.nan)
    off[:, clear.sum(axis=0) < _LEAST_VIEWS] = 0.0
    return np.asarray(np.nanmedian(off, axis=0))


def _stretch(line: Array, more_mm: float) -> Array:
    """Lengthen a chain of nodes (n, 3) by ``more_mm``, or shorten it if ``more_mm`` is negative.

    The first node is fixed.
    """
    along = polyline.arc_length_mm(line)
    if more_mm == 0.0 or along[-1] < SPACING_MM:
        return line
    last = line[-1] - line[max(len(line) - 1 - TANGENT_NODES, 0)]
    onward = line[-1] + last * (max(more_mm, 0.0) / max(float(np.linalg.norm(last)), 1e-12))
    longer = np.concatenate([line, onward[None]])
    return polyline.interpolate(longer, polyline.arc_length_mm(longer), along * max(1.0 + more_mm / along[-1], _LEAST_LENGTH))
