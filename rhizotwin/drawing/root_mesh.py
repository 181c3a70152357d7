"""Mesh of roots for display, with one coloured tube for each root.

Tubes that overlap are not united to one surface.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from rhizotwin.recon.results.parts import Mesh
from rhizotwin.recon.tubes.tube_mesh import AROUND, tube
from rhizotwin.scenes.rsml import Root

if TYPE_CHECKING:
    import trimesh

THICKEST_PERCENT = 98.0
"""Percentile of the diameters at which the colour scale ends. A thick taproot would otherwise leave only a small part
of the scale for all other roots."""


def unite_tubes(roots: Sequence[Root]) -> Mesh:
    """Return a mesh of closed tubes along one or more roots, in the canister frame."""
    parts = [tube(root.points_mm, root.diameters_mm) for root in roots]
    first = np.cumsum([0, *(len(vertices) for vertices, _ in parts[:-1])])
    faces = [part + start for (_, part), start in zip(parts, first, strict=True)]
    return Mesh(vertices_mm=np.concatenate([vertices for vertices, _ in parts]), faces=np.concatenate(faces))


def tubes(roots: Sequence[Root], *, colour: str) -> trimesh.Trimesh:
    """Return a mesh of closed tubes along roots, in mm in the canister frame.

    Each vertex has a colour.

    Parameters
    ----------
    roots : sequence of Root
        One or more roots.
    colour : str
        Coloured property: "order" (cycle of ten colours) or "diameter" (viridis from 0 to the 98th percentile).
    """
    import trimesh  # these two imports take half a second, and the other functions do not need them
    from matplotlib import colormaps

    if colour == "order":
        shades = colormaps["tab10"](np.repeat([root.order % 10 for root in roots], [AROUND * len(root.points_mm) + 2 for root in roots]))
    else:
        thickest = np.percentile(np.concatenate([root.diameters_mm for root in roots]), THICKEST_PERCENT)
        along = [np.concatenate([np.repeat(root.diameters_mm, AROUND), root.diameters_mm[[0, -1]]]) for root in roots]
        shades = colormaps["viridis"](np.clip(np.concatenate(along) / thickest, 0.0, 1.0))
    mesh = unite_tubes(roots)
    return trimesh.Trimesh(mesh.vertices_mm, mesh.faces, vertex_colors=np.round(255.0 * shades).astype(np.uint8), process=False)
