"""The shape of a result packed for the page: centre lines and diameters, or a surface, as whole numbers in base64."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.results.parts import Mesh
from rhizotwin.recon.uncertainty.budget import NINETY
from rhizotwin.scenes.rsml import Root
from rhizotwin.simpler import simpler
from rhizotwin.stored.result_files import read_mesh

MOST_TRIANGLES = 120_000
"""Of a surface in a page: about 2.5 MB."""
_LEVELS = 65535


def packed(roots: Sequence[Root], surface: Path) -> dict[str, Any]:
    """Return roots, or where there are none the surface in a file, as JSON values that `page.js` reads.

    Coordinates are steps of the largest extent over 65535, a few micrometres; diameters and their 90 % half-widths
    steps of 1 micrometre. Where the uncertainty of a diameter is not known, there are no half-widths.
    """
    return _lines(roots) if roots else _surface(simpler(read_mesh(surface), MOST_TRIANGLES))


def _lines(roots: Sequence[Root]) -> dict[str, Any]:
    points = np.concatenate([root.points_mm for root in roots])
    steps, origin, scale = _steps(points)
    sigmas = [root.diameter_sigma_mm for root in roots if root.diameter_sigma_mm is not None]
    halves = {"halves": _micrometres([NINETY * sigma for sigma in sigmas])} if len(sigmas) == len(roots) else {}
    return halves | {
        "kind": "roots",
        "origin": origin,
        "scale": scale,
        "points": _text(steps),
        "diameters": _micrometres([root.diameters_mm for root in roots]),
        "counts": [len(root.points_mm) for root in roots],
        "orders": [root.order for root in roots],
        "parents": [root.parent for root in roots],
    }


def _surface(mesh: Mesh) -> dict[str, Any]:
    steps, origin, scale = _steps(mesh.vertices_mm)
    return {"kind": "surface", "origin": origin, "scale": scale, "points": _text(steps), "faces": _text(mesh.faces.astype("<u4"))}


def _micrometres(parts_mm: Sequence[NDArray[np.float64]]) -> str:
    return _text(np.clip(np.round(1000.0 * np.concatenate(parts_mm)), 0, _LEVELS).astype("<u2"))


def _steps(points_mm: NDArray[np.float64]) -> tuple[NDArray[np.uint16], list[float], float]:
    low = points_mm.min(axis=0)
    scale = max(float(np.ptp(points_mm, axis=0).max()), 1e-6) / _LEVELS
    return np.round((points_mm - low) / scale).astype("<u2"), [float(x) for x in low], scale


def _text(values: NDArray[Any]) -> str:
    return base64.b64encode(np.ascontiguousarray(values).tobytes()).decode("ascii")
