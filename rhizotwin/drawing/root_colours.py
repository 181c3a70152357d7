"""Colour maps of roots by order, diameter, depth, uncertainty or tip visibility, with their colour keys."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from rhizotwin.corrections.lines import Line, Lines
from rhizotwin.drawing import surface_mesh
from rhizotwin.drawing.root_mesh import THICKEST_PERCENT
from rhizotwin.recon.uncertainty.budget import NINETY

Array = NDArray[np.float64]
Bytes = NDArray[np.uint8]
Rgb = tuple[int, int, int]
Colouring = Callable[[int, Line], Bytes]
"""Function that returns the colours (N, 3) of the points of a root. Its arguments are the number of the root and its
centre line."""

ORDERS: tuple[Rgb, ...] = ((222, 160, 92), (31, 119, 180), (214, 39, 40), (44, 160, 44), (148, 103, 189), (230, 90, 200))
"""Colour of each root order, beginning with main roots. The last colour is used for all higher orders."""
SURFACE: Rgb = ORDERS[0]
"""Colour of a surface without centre lines."""
VISIBLE, HIDDEN = (44, 120, 160), (230, 120, 30)
"""Colour of roots whose tip is visible, and colour of roots whose tip is hidden by other roots."""
SELECTED: Rgb = (255, 210, 0)
"""Colour of selected roots and voxels in 3D and in pictures."""
UNKNOWN: Rgb = (150, 150, 150)
CHOICES = ("order", "diameter", "depth", "uncertainty", "tip visibility")
PER_ROOT = ("uncertainty", "tip visibility")
"""Quantities by which roots can be coloured, and whose colours depend on one root only. They do not change when other
roots are edited."""
WIDEST_UNCERTAINTY = 0.25
"""Uncertainty of the diameter that has the last colour of the scale. The uncertainty is half the width of the 90 %
interval, relative to the diameter (`recon.uncertainty.root_uncertainty`)."""


@dataclass(frozen=True)
class Key:
    """Colour key of a picture.

    It consists of colour swatches with labels, or of a continuous scale with a label at each end.
    """

    swatches: tuple[tuple[Rgb, str], ...] = ()
    ends: tuple[str, str] | None = None
    """Labels at the first and the last colour of the continuous scale (viridis), or None if the key consists of
    swatches."""


def colour_roots(by: str, lines: Lines) -> tuple[Colouring, Key]:
    """Return a function that computes the colours (N, 3) of the points of a root, and a colour key.

    Parameters
    ----------
    by : str
        Coloured property, one of `CHOICES`.
    lines : Lines
        Centre lines of all roots, by number.
    """
    if by == "order":
        orders = root_orders(lines)
        highest = min(max(orders.values(), default=0), len(ORDERS) - 1)
        key = Key(swatches=tuple((ORDERS[order], order_name(order)) for order in range(highest + 1)))
        return lambda number, line: _uniform(ORDERS[min(orders[number], len(ORDERS) - 1)], line), key
    if by == "tip visibility":
        key = Key(swatches=((VISIBLE, "tip visible"), (HIDDEN, "tip hidden by other roots")))
        return lambda _, line: _uniform(VISIBLE if line.tip_seen else HIDDEN, line), key
    if by == "uncertainty":
        if all(line.sigma_mm is None for line in lines.values()):
            return lambda _, line: _uniform(UNKNOWN, line), Key(swatches=((UNKNOWN, "uncertainty not available"),))
        return lambda _, line: _by_uncertainty(line), Key(ends=("diameter ±0 %", f"±{100.0 * WIDEST_UNCERTAINTY:.0f} % or more (90 %)"))
    if by == "diameter":
        every = np.concatenate([np.zeros(1), *(line.diameters_mm for line in lines.values())])
        most = max(float(np.percentile(every, THICKEST_PERCENT)), 1e-6)
        return lambda _, line: scale_colours(line.diameters_mm / most), Key(ends=("0 mm", f"{most:.2g} mm or more"))
    heights = np.concatenate([np.zeros(0), *(line.points_mm[:, 2] for line in lines.values())])
    colour, key = colour_depths(heights)
    return lambda _, line: colour(line.points_mm[:, 2]), key


def colour_depths(heights_mm: Array) -> tuple[Callable[[Array], Bytes], Key]:
    """Return a function that converts heights (N,) to colours (N, 3), and a colour key.

    The colour scale covers the range of the given heights.
    """
    top, bottom = (float(heights_mm.max()), float(heights_mm.min())) if len(heights_mm) else (0.0, -1.0)
    span = max(top - bottom, 1e-6)
    return lambda z: scale_colours((top - z) / span), Key(ends=(f"{-top:.0f} mm below the rim", f"{-bottom:.0f} mm"))


def colour_surface(points_mm: Array, lines: Lines, colour: Colouring) -> Bytes:
    """Return the colours (N, 3) of points on the surface.

    Each point has the colour of the nearest root.

    Parameters
    ----------
    points_mm : (N, 3) float64 array
        Points on or near the surface, canister frame.
    lines : Lines
        Centre lines of one or more roots, by number.
    colour : callable
        Function from `colour_roots` that computes the colours of a root's points.
    """
    points = np.concatenate([line.points_mm for line in lines.values()])
    radii = np.concatenate([line.diameters_mm for line in lines.values()]) / 2.0
    shades = np.concatenate([colour(number, line) for number, line in lines.items()])
    return shades[surface_mesh.nearest_root(points_mm, points, radii)]


def order_name(order: int) -> str:
    """Return the name of a root order, such as "main root" or "lateral, 1st order"."""
    if order == 0:
        return "main root"
    ordinal = {1: "1st", 2: "2nd", 3: "3rd"}.get(order, f"{order}th")
    return f"lateral, {ordinal} order" + (" or higher" if order == len(ORDERS) - 1 else "")


def half_widths(line: Line) -> Array | None:
    """Return half the width (N,) of the 90 % interval of each diameter of a root, in mm.

    The result is None if the intervals are unknown.
    """
    return None if line.sigma_mm is None else NINETY * line.sigma_mm


def root_orders(lines: Lines) -> dict[int, int]:
    """Return the order of each root, keyed by root number.

    A root without parent has the order 0, and its laterals have the order 1.
    """
    orders: dict[int, int] = {}
    for number in lines:
        path, here = list[int](), number
        while here in lines and here not in orders:
            path.append(here)
            here = lines[here].parent
        order = orders.get(here, -1)
        for root in reversed(path):
            order += 1
            orders[root] = order
    return orders


def scale_colours(share: Array) -> Bytes:
    """Return the colours (N, 3) of values from 0 to 1 on the continuous scale (viridis)."""
    shades = cv2.applyColorMap(np.arange(256, dtype=np.uint8)[:, None], cv2.COLORMAP_VIRIDIS)[:, 0, ::-1]
    return np.asarray(shades[np.clip(256.0 * share, 0.0, 255.0).astype(np.int64)])


def _by_uncertainty(line: Line) -> Bytes:
    half = half_widths(line)
    return _uniform(UNKNOWN, line) if half is None else scale_colours(half / np.maximum(line.diameters_mm, 1e-9) / WIDEST_UNCERTAINTY)


def _uniform(colour: Rgb, line: Line) -> Bytes:
    return np.tile(np.array(colour, np.uint8), (len(line.points_mm), 1))
