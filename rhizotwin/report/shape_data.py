"""Pack the shape of a result for the HTML report: surface, centre lines and colours as integers in base64."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rhizotwin.corrections.lines import as_lines
from rhizotwin.drawing import root_colours, surface_mesh
from rhizotwin.drawing.root_colours import Key
from rhizotwin.recon.results.parts import Mesh
from rhizotwin.scenes.rsml import Root

_LEVELS = 65535
"""Largest unsigned 16-bit integer. Coordinates are scaled to the range from 0 to this value."""


def pack_shape(surface: Mesh, roots: Sequence[Root]) -> dict[str, Any]:
    """Return a surface with centre lines and colours as JSON values that ``page.js`` reads.

    Coordinates are integers in units of 1/65535 of the largest extent, which are a few micrometres. Each vertex
    refers to the nearest centre-line point and has the colour of this point.

    Parameters
    ----------
    surface : Mesh
        Closed surface with a reduced number of triangles, see `surface_mesh`.
    roots : sequence of Root
        Roots with centre lines, may be empty.
    """
    packed = _pack_positions(surface.vertices_mm) | {"faces": _encode(surface.faces.astype("<u4")), "plain": root_colours.SURFACE}
    if not roots:
        colour, key = root_colours.colour_depths(surface.vertices_mm[:, 2])
        return packed | {"colours": {"depth": _encode(colour(surface.vertices_mm[:, 2]))}, "keys": {"depth": _pack_key(key)}}
    points = np.concatenate([root.points_mm for root in roots])
    diameters = np.concatenate([root.diameters_mm for root in roots])
    nearest = surface_mesh.nearest_root(surface.vertices_mm, points, diameters / 2.0)
    lines = _pack_positions(points) | {"counts": [len(root.points_mm) for root in roots]}
    return packed | {"nearest": _encode(nearest.astype("<u4")), "roots": lines, **_pack_colours(roots)}


def _pack_colours(roots: Sequence[Root]) -> dict[str, Any]:
    """Return the colours of all centre-line points and the colour keys.

    Each property that can be displayed has its own colours and its own key.
    """
    lines = as_lines(roots)
    choices = ["order", "diameter", "depth"] + ["uncertainty"] * all(line.sigma_mm is not None for line in lines.values())
    colours, keys = {}, {}
    for by in choices:
        colour, key = root_colours.colour_roots(by, lines)
        colours[by] = _encode(np.concatenate([colour(number, line) for number, line in lines.items()]))
        keys[by] = _pack_key(key)
    return {"colours": colours, "keys": keys}


def _pack_key(key: Key) -> dict[str, Any]:
    return {"swatches": [{"rgb": rgb, "label": label} for rgb, label in key.swatches], "ends": key.ends}


def _pack_positions(points_mm: NDArray[np.float64]) -> dict[str, Any]:
    if not len(points_mm):
        return {"origin": [0.0, 0.0, 0.0], "scale": 1.0, "points": ""}
    low = points_mm.min(axis=0)
    scale = max(float(np.ptp(points_mm, axis=0).max()), 1e-6) / _LEVELS
    return {"origin": [float(x) for x in low], "scale": scale, "points": _encode(np.round((points_mm - low) / scale).astype("<u2"))}


def _encode(values: NDArray[Any]) -> str:
    return base64.b64encode(np.ascontiguousarray(values).tobytes()).decode("ascii")
