"""Detection of the canister's edges, the water surface and the empty backlight panel in pictures without markers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.robust import MAD
from rhizotwin.scenes.errors import UserError

Array = NDArray[np.float64]
Stack = NDArray[np.uint8 | np.uint16]

BARE_QUANTILE = 0.85
"""Quantile of a pixel's values over the turn that is used as the brightness of the pixel without roots. Roots cover a
pixel in less than a seventh of the views."""
EDGE_REACH_PX = 12
"""Half-width of the search range around each edge of the mean picture, px. The canister may be a few pixels off the
table's axis."""
EDGE_WIDTH_PX = 4
"""Width of the intensity transition at an edge in focus, px."""
PANEL_SHARE = 0.85
"""Brightness above which a pixel shows the empty backlight panel, as a fraction of the 95th percentile of the empty
panel's picture."""
WATER_QUANTILE = 0.25
"""Quantile of a row's brightness across the canister that decides whether the row shows the water. It is high if the
backlight panel is visible in at least three quarters of the row."""
BAND = 0.06
"""Fraction of the water's height that is excluded both at the water surface and at the floor, where reflections
occur."""


@dataclass(frozen=True)
class Edges:
    """Position of the canister in the pictures."""

    axis_px: Array
    """(V, 2) position of the canister's axis in each view: its column at the row ``middle``, px, and the change of the
    column per row."""
    width_px: float
    """Median width between the outer edges of the canister, px."""
    middle: float
    """Row at which the columns in ``axis_px`` are given."""
    rows: tuple[int, int]
    """First row of the water, and the row after its last row."""
    columns: tuple[int, int]
    """First column in which the backlight panel is visible through the canister, and the column after the last one."""
    floor_seen: bool
    """Whether the floor of the canister is visible in the pictures."""


def empty_panel(stack: Stack) -> NDArray[np.float32]:
    """Estimate the picture (H, W) of the empty backlight panel from the pictures of a turn.

    The picture is computed in blocks of rows to limit the memory.
    """
    bare = np.empty(stack.shape[1:], np.float32)
    for first in range(0, len(bare), 64):
        bare[first : first + 64] = np.quantile(stack[:, first : first + 64], BARE_QUANTILE, axis=0)
    return np.maximum(bare, 1.0)


def _runs(bright: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return the first index and the index after the last of every run of true values."""
    change = np.flatnonzero(np.diff(np.concatenate([[0], bright.astype(np.int8), [0]])))
    return list(zip(change[::2].tolist(), change[1::2].tolist(), strict=True))


def find_edges(stack: Stack, bare: NDArray[np.float32]) -> tuple[Edges, float]:
    """Find the outer edges of the canister in every view, and the extent of the water.

    Parameters
    ----------
    stack : (V, H, W) uint8 or uint16 array
        Pictures of the views.
    bare : (H, W) float32 array
        Picture of the empty panel.

    Returns
    -------
    Edges, float
        Edges of the canister, and the standard deviation of the width between them, px.
    """
    height, width = bare.shape
    panel = float(np.quantile(bare, 0.95))  # a high quantile, robust against lights and reflections
    profile = np.median(bare[height // 4 : 3 * height // 4], axis=0)
    runs = [run for run in _runs(profile > 0.5 * panel) if run[1] - run[0] > 2 * EDGE_REACH_PX]
    inside = max(runs, key=lambda run: (run[0] <= width // 2 < run[1], run[1] - run[0]), default=(0, 0))
    bright = [run for run in _runs(profile > PANEL_SHARE * panel) if run[1] - run[0] > 2 * EDGE_REACH_PX]
    left, right = [run for run in bright if run[1] <= inside[0]], [run for run in bright if run[0] >= inside[1]]
    if not left or not right:
        raise UserError(
            "the two outer edges of the canister are not visible. The panel must be visible on both sides of the canister and through it."
        )
    # A quantile below the median, as no panel is visible in the middle above the water.
    down = np.quantile(bare[:, inside[0] : inside[1]], WATER_QUANTILE, axis=1)
    water = max(_runs(down > 0.5 * panel), key=lambda run: run[1] - run[0], default=(0, 0))
    if water[0] == 0 or water[1] - water[0] < height // 8:
        raise UserError(
            "the water surface is not visible, so heights cannot be determined. The water surface must lie within the pictures."
        )
    margin = round(BAND * (water[1] - water[0]))
    rows = np.arange(water[0] + margin, water[1] - margin)
    middle = float(rows.mean())
    from_left = np.array([_fit_edge_line(picture, rows, middle, left[-1][1], panel) for picture in stack])
    from_right = np.array([_fit_edge_line(picture[:, ::-1], rows, middle, width - right[0][0], panel) for picture in stack])
    from_right = np.array([width - 1.0, 0.0]) - from_right
    widths = from_right[:, 0] - from_left[:, 0]
    found = Edges(
        axis_px=0.5 * (from_left + from_right),
        width_px=float(np.median(widths)),
        middle=middle,
        rows=water,
        columns=inside,
        floor_seen=water[1] < height,
    )
    return found, float(np.std(widths) / np.sqrt(len(widths)))


def _fit_edge_line(picture: Stack, rows: NDArray[np.int64], middle: float, at: int, panel: float) -> Array:
    """Fit a straight line to the boundary between the bright panel and the canister.

    Return the column of the line at the row ``middle``, and the change of the column per row. The search starts at the
    column ``at``, and the fit is robust against outliers.

    The edge lies at half the brightness between the panel and the darkest of the few pixels behind the edge, which may
    not be black.
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
        raise UserError("the outer edge of the canister was not found in a picture. Keep the panel beside the canister free of objects.")
    weight, line = np.ones(len(x)), np.zeros(2)
    for _ in range(8):
        line = np.polyfit(y, x, 1, w=weight)[::-1]
        off = np.abs(x - line[0] - line[1] * y)
        weight = 1.0 / (1.0 + (off / (2.0 * MAD * np.median(off) + 1e-6)) ** 2)
    return line
