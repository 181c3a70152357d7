"""Colours for roots, and what they mean in words."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from rhizotwin.corrections.lines import Line, Lines
from rhizotwin.recon.uncertainty.budget import NINETY

Array = NDArray[np.float64]
Bytes = NDArray[np.uint8]

ORDERS = ((68, 68, 68), (31, 119, 180), (214, 39, 40), (44, 160, 44), (148, 103, 189), (255, 127, 14))
"""Taproot first; the last stands for all higher orders."""
SEEN, UNSEEN = (44, 120, 160), (230, 120, 30)
THICKEST_PERCENT = 98.0
CHOICES = ("order", "diameter", "depth", "uncertainty", "end seen or not")
OF_ONE = ("uncertainty", "end seen or not")
"""What a root's colour depends on itself alone for."""
LEAST_KNOWN = 0.25
"""Colours by uncertainty end here: what may be farther off is no measurement (`recon.uncertainty.root_uncertainty`)."""
UNKNOWN = (150, 150, 150)


def colouring(by: str, lines: Lines) -> tuple[Callable[[int, Line], Bytes], str]:
    """Return what colours (N, 3) the points of a root have, and a legend.

    Parameters
    ----------
    by : str
        One of `CHOICES`.
    """
    if by == "order":
        orders = order_of(lines)
        return lambda number, line: _flat(ORDERS[min(orders[number], len(ORDERS) - 1)], line), (
            "grey: main root; blue: laterals; red, green, ...: laterals of laterals"
        )
    if by == "end seen or not":
        legend = "blue: the root's end was seen; orange: others hide where it ends"
        return lambda _, line: _flat(SEEN if line.tip_seen else UNSEEN, line), legend
    if by == "uncertainty":
        none = all(line.sigma_mm is None for line in lines.values())
        return lambda _, line: _uncertain(line), (
            "not known: made before uncertainties were kept, or drawn by hand"
            if none
            else f"violet: the diameter is certain; yellow: it may be {100.0 * LEAST_KNOWN:.0f} % off or more (90 % interval)"
        )
    if by == "diameter":
        every = np.concatenate([np.zeros(1), *(line.diameters_mm for line in lines.values())])
        most = max(float(np.percentile(every, THICKEST_PERCENT)), 1e-6)
        return lambda _, line: _scaled(line.diameters_mm / most), f"violet: 0 mm; yellow: {most:.2g} mm or more"
    depth = np.concatenate([np.zeros(0), *(line.points_mm[:, 2] for line in lines.values())])
    top, bottom = (float(depth.max()), float(depth.min())) if len(depth) else (0.0, -1.0)
    span = max(top - bottom, 1e-6)
    legend = f"violet: {-top:.0f} mm below the rim; yellow: {-bottom:.0f} mm"
    return lambda _, line: _scaled((top - line.points_mm[:, 2]) / span), legend


def half_width(line: Line) -> Array | None:
    """Return the 90 % half-width of a root's diameters (N,), mm; None where it is not known."""
    return None if line.sigma_mm is None else NINETY * line.sigma_mm


def _uncertain(line: Line) -> Bytes:
    half = half_width(line)
    return _flat(UNKNOWN, line) if half is None else _scaled(half / np.maximum(line.diameters_mm, 1e-9) / LEAST_KNOWN)


def order_of(lines: Lines) -> dict[int, int]:
    """Return each root's order, 0 for a root without parent."""
    found: dict[int, int] = {}
    for number in lines:
        way, here = list[int](), number
        while here in lines and here not in found:
            way.append(here)
            here = lines[here].parent
        order = found.get(here, -1)
        for one in reversed(way):
            order += 1
            found[one] = order
    return found


def _flat(colour: tuple[int, int, int], line: Line) -> Bytes:
    return np.tile(np.array(colour, np.uint8), (len(line.points_mm), 1))


def _scaled(share: Array) -> Bytes:
    from matplotlib import colormaps  # not for the first picture

    return np.asarray(np.round(255.0 * colormaps["viridis"](np.clip(share, 0.0, 1.0))[:, :3]), np.uint8)
