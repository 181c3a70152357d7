"""Paint the marker strip.

It consists of black markers on white paper and is unrolled from the net pot.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rhizotwin.scenes.markers import marker_cells, strip_ids
from rhizotwin.scenes.model import MarkerStrip, NetPot

PAPER, INK = 0.85, 0.04
"""Diffuse reflectance of white office paper, and of toner on it."""
MM_PER_TEXEL = 1.0 / 16.0
"""Edge of a texel, mm. It is a quarter of the width of a pixel of a typical rig (0.23 mm). A texel that is partly
covered by a marker is painted with the covered fraction."""


def strip_picture(strip: MarkerStrip, net_pot: NetPot, *, mm_per_texel: float = MM_PER_TEXEL) -> NDArray[np.float32]:
    """Paint the reflectance of the marker strip, unrolled from the net pot.

    Each value is an average over a texel.

    Parameters
    ----------
    strip : MarkerStrip
        Marker strip.
    net_pot : NetPot
        Net pot with the strip on its outside.
    mm_per_texel : float
        Edge of a texel, mm.

    Returns
    -------
    (rows, columns) float32 array
        Reflectance, 0 to 1, with row 0 at the net pot's top and column 0 at the seam. The azimuth (counter-clockwise
        from above) increases with the column, so that the picture is not mirrored when seen from outside. Markers are
        exactly at the positions of `scenes.plan.marker_corners`.
    """
    around_mm = 2.0 * np.pi * net_pot.outer_radius_mm
    high_mm = net_pot.top_mm - net_pot.skirt_bottom_mm
    columns, rows = round(around_mm / mm_per_texel), round(high_mm / mm_per_texel)
    s_edges_mm = np.linspace(0.0, around_mm, columns + 1)
    z_edges_mm = net_pot.top_mm - np.linspace(0.0, high_mm, rows + 1)
    picture, ids = np.full((rows, columns), PAPER), strip_ids(strip)
    for row in range(strip.rows):
        top_mm = strip.bottom_mm + (strip.rows - 1 - row) * strip.row_pitch_mm + strip.marker_mm
        for column in range(strip.columns):
            cells = marker_cells(strip.dictionary, int(ids[row, column]))
            cell_mm = strip.marker_mm / len(cells)
            left_mm = (column + 0.5) * around_mm / strip.columns - strip.marker_mm / 2.0
            across = _share(s_edges_mm, left_mm + cell_mm * np.arange(len(cells) + 1))
            down = _share(-z_edges_mm, -top_mm + cell_mm * np.arange(len(cells) + 1))
            j, i = np.flatnonzero(down.any(axis=1)), np.flatnonzero(across.any(axis=1))
            black = down[j] @ (~cells).astype(np.float64) @ across[i].T
            picture[np.ix_(j, i)] += black * (INK - PAPER)
    return picture.astype(np.float32)


def finest_mm(strip: MarkerStrip, net_pot: NetPot) -> float:
    """Return the width of the finest structure of the strip: a cell of a marker or a gap between markers, mm.

    It is infinite for a strip without markers.
    """
    if strip.rows == 0:
        return math.inf
    cells = len(marker_cells(strip.dictionary, strip.first_id))
    column_pitch_mm = 2.0 * np.pi * net_pot.outer_radius_mm / strip.columns
    gaps_mm = [column_pitch_mm - strip.marker_mm] + [strip.row_pitch_mm - strip.marker_mm] * (strip.rows > 1)
    return float(min(strip.marker_mm / cells, *gaps_mm))


def _share(texel_edges: NDArray[Any], cell_edges: NDArray[Any]) -> NDArray[np.float64]:
    """Return the fraction of each texel (T,) that each cell (C,) covers, as an array (T, C).

    The edges of texels and cells are in ascending order.
    """
    low = np.maximum(texel_edges[:-1, None], cell_edges[None, :-1])
    high = np.minimum(texel_edges[1:, None], cell_edges[None, 1:])
    share: NDArray[np.float64] = np.clip(high - low, 0.0, None) / np.diff(texel_edges)[:, None]
    return share
