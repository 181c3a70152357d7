"""Edges of the canister, surface of the water and the empty panel in telecentric pictures without markers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.robust import MAD
from rhizotwin.scenes.errors import UserError

Array = NDArray[np.float64]
Stack = NDArray[np.uint8 | np.uint16]

BARE_QUANTILE = 0.85
"""Quantile over the turn of a pixel's values for the empty panel; roots cover it in less than a seventh of the
views."""
EDGE_REACH_PX = 12
"""Search range about the edge in the mean picture, for a canister a few pixels off the table's axis."""
EDGE_WIDTH_PX = 4
"""Width over which an edge in focus falls from bright to dark."""
PANEL_SHARE = 0.85
"""Minimum brightness of the empty panel, as a fraction of its typical brightness."""
WATER_QUANTILE = 0.25
"""Quantile of a row's brightness across the canister; it is bright if three quarters of the row show the panel."""
BAND = 0.06
"""Fraction of the water's height excluded at its surface and floor, where there are reflections."""


@dataclass(frozen=True)
class Edges:
    """Position of the canister in the pictures."""

    axis_px: Array
    """(V, 2) column of the axis at ``middle`` and its change per row."""
    width_px: float
    inner_px: float
    middle: float
    """Reference row of ``axis_px``."""
    rows: tuple[int, int]
    """First row of the water, and the row after the last."""
    columns: tuple[int, int]
    """The same for the columns through which the panel is visible."""
    floor_seen: bool


def empty_panel(stack: Stack) -> NDArray[np.float32]:
    """Return the empty panel (H, W), computed in blocks of rows."""
    bare = np.empty(stack.shape[1:], np.float32)
    for first in range(0, len(bare), 64):
        bare[first : first + 64] = np.quantile(stack[:, first : first + 64], BARE_QUANTILE, axis=0)
    return np.maximum(bare, 1.0)


def _runs(bright: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return first and past-the-last index of every run of true values."""
    change = np.flatnonzero(np.diff(np.concatenate([[0], bright.astype(np.int8), [0]])))
    return list(zip(change[::2].tolist(), change[1::2].tolist(), strict=True))


def find_edges(stack: Stack, bare: NDArray[np.float32]) -> tuple[Edges, float]:
    """Find the canister's outer edges in every view, and the extent of the water.

    Parameters
    ----------
    stack : (V, H, W) uint8 or uint16 array
        Pictures.
    bare : (H, W) float32 array
        The empty panel.

    Returns
    -------
    Edges, float
        The edges, and the standard deviation of the width, px.
    """
    height, width = bare.shape
    panel = float(np.quantile(bare, 0.95))  # a high quantile, robust against lights and reflections
    profile = np.median(bare[height // 4 : 3 * height // 4], axis=0)
    runs = [run for run in _runs(profile > 0.5 * panel) if run[1] - run[0] > 2 * EDGE_REACH_PX]
    inside = max(runs, key=lambda run: (run[0] <= width // 2 < run[1], run[1] - run[0]), default=(0, 0))
    bright = [run for run in _runs(profile > PANEL_SHARE * panel) if run[1] - run[0] > 2 * EDGE_REACH_PX]
    left, right = [run for run in bright if run[1] <= inside[0]], [run for run in bright if run[0] >= inside[1]]
    if not left or not right:
        raise UserError("the two outer edges of the canister are not visible; the panel must be visible on both sides of it and through it")
    # A quantile below the median, as no panel is visible in the middle above the water.
    down = np.quantile(bare[:, inside[0] : inside[1]], WATER_QUANTILE, axis=1)
    water = max(_runs(down > 0.5 * panel), key=lambda run: run[1] - run[0], default=(0, 0))
    if water[0] == 0 or water[1] - water[0] < height // 8:
        raise UserError("the water surface is not visible, so heights cannot be determined; it must lie within the pictures")
    margin = round(BAND * (water[1] - water[0]))
    rows = np.arange(water[0] + margin, water[1] - margin)
    middle = float(rows.mean())
    from_left = np.array([_edge_line(picture, rows, middle, left[-1][1], panel) for picture in stack])
    from_right = np.array([_edge_line(picture[:, ::-1], rows, middle, width - right[0][0], panel) for picture in stack])
    from_right = np.array([width - 1.0, 0.0]) - from_right
    widths = from_right[:, 0] - from_left[:, 0]
    found = Edges(
        axis_px=0.5 * (from_left + from_right),
        width_px=float(np.median(widths)),
        inner_px=float(inside[1] - inside[0]),
        middle=middle,
        rows=water,
        columns=inside,
        floor_seen=water[1] < height,
    )
    return found, float(np.std(widths) / np.sqrt(len(widths)))


def _edge_line(picture: Stack, rows: NDArray[np.int64], middle: float, at: int, panel: float) -> Array:
    """Return the column at the middle row, and its change per row, of the edge of the panel.

    The fit is robust, and starts at the column ``at``.

    The edge is at half the brightness between the panel and the darkest of the few pixels behind it, which may not be
    black.
    """
    first = max(at - EDGE_REACH_PX, 0)
    part = picture[rows, first : at + 2 * EDGE_REACH_PX].astype(np.float64)
    begin = np.argmax(part < PANEL_SHARE * panel, axis=1)
    behind = np.take_along_axis(part, np.minimum(begin[:, None] + np.arange(EDGE_WIDTH_PX), part.shape[1] - 1), 1)
    level = 0.5 * (panel + behind.min(axis=1))
    below = part < level[:, None]
    step = np.maximum(np.argmax(below, axis=1), 1)
    a, b = (np.take_along_axis(part, step[:, None] + k, 1)[:, 0] for k in (-1, 0))
    crossed = below.any(axis=1) & (a >= level) & (b < level)
    place = first + step - 1 + (a - level) / np.where(a > b, a - b, 1.0)
    y, x = rows[crossed] - middle, place[crossed]
    if len(x) < len(rows) // 2:
        raise UserError("the outer edge of the canister was not found in a picture; keep the panel beside the canister free")
    weight, line = np.ones(len(x)), np.zeros(2)
    for _ in range(8):
        line = np.polyfit(y, x, 1, w=weight)[::-1]
        off = np.abs(x - line[0] - line[1] * y)
        weight = 1.0 / (1.0 + (off / (2.0 * MAD * np.median(off) + 1e-6)) ** 2)
    return line
