"""One result as the viewer holds it.

Its corrections, pictures, surface and truth, each read when it is first asked for.
"""

from __future__ import annotations

from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rhizotwin.corrections.session import Measured, Session
from rhizotwin.recon.results.parts import Mesh
from rhizotwin.scenes.dataset import Dataset, load_dataset
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.traits import Traits, measure_traits
from rhizotwin.simpler import simpler
from rhizotwin.stored import result_files
from rhizotwin.through_water import Pictures
from rhizotwin.viewer.scene3d import MOST_TRIANGLES

_EMPTY_MM3 = 1e-9
FARTHEST_MM = 1.0
"""Distance colours end here."""


class Shown:
    """A result with all that can be shown of it."""

    def __init__(self, folder: Path, dataset_folder: Path | None) -> None:
        self.session = Session(folder)
        self._given = dataset_folder
        self._surface_now: tuple[object, Mesh] | None = None

    @property
    def name(self) -> str:
        """Return what to call it."""
        return self.session.folder.name or str(self.session.folder)

    @cached_property
    def dataset(self) -> Dataset | None:
        """Return the dataset that it was made from; None where it is no longer there and none was given."""
        folder = self._given or Path(str(self.session.summary["dataset"]))
        try:
            found = load_dataset(folder)
            result_files.check_same_scan(self.session.summary["dataset_sha256"], self.session.summary["scene"], self.session.folder, found)
        except UserError:
            if self._given is not None:
                raise
            return None
        return found

    @cached_property
    def pictures(self) -> Pictures | None:
        """Return the pictures with cameras; None without the dataset."""
        return None if self.dataset is None else Pictures.of(self.dataset, self.session.summary)

    @property
    def truth_file(self) -> Path | None:
        """Return where the true solid of a simulated dataset lies."""
        file = None if self.dataset is None else self.dataset.folder / "truth" / "specimen.ply"
        return file if file is not None and file.is_file() else None

    @cached_property
    def truth(self) -> Mesh | None:
        """Return the true solid of a simulated dataset."""
        return None if self.truth_file is None else simpler(result_files.read_mesh(self.truth_file), MOST_TRIANGLES)

    def surface_now(self) -> Mesh:
        """Return the surface as corrected."""
        from rhizotwin.corrections import corrected

        edits = self.session.log.edits
        if self._surface_now is None or self._surface_now[0] != edits:
            whole = corrected.read_mesh(self.session) if edits else result_files.read_mesh(self.session.folder / "shape.ply")
            self._surface_now = edits, simpler(whole, MOST_TRIANGLES)
        return self._surface_now[1]

    def traits(self) -> Traits:
        """Measure the traits as corrected, from centre lines and voxels; the surface's area is left out."""
        measured, roots = self.session.measure(), self.session.state.roots()
        points = np.concatenate([_ends(measured), *(root.points_mm for root in roots)])
        if not len(points):
            points = np.zeros((1, 3))
        mass_g = self.session.summary.get("mass_g") if measured.volume_mm3 > 0.0 else None
        return measure_traits(roots, points, volume_mm3=measured.volume_mm3, surface_mm2=0.0, mass_g=mass_g)

    def distance_colours(self, mesh: Mesh) -> NDArray[np.uint8]:
        """Return the vertices' colours by their distance to the truth, from 0 (violet) to `FARTHEST_MM` (yellow)."""
        from matplotlib import colormaps

        from rhizotwin.scoring import surface_distance

        if self.truth is None:
            raise UserError(f"{self.name}: there is no truth to compare with; only simulated scans have one")
        away = surface_distance.distances(mesh.vertices_mm, self.truth.vertices_mm, self.truth.faces)
        return np.asarray(np.round(255.0 * colormaps["viridis"](np.clip(away / FARTHEST_MM, 0.0, 1.0))), np.uint8)


def _ends(measured: Measured) -> NDArray[np.float64]:
    """Return the corners (N, 3) of each column's lowest and highest voxel: all that a hull needs."""
    solid, rows = measured.solid, np.flatnonzero(measured.volumes_mm3 > _EMPTY_MM3)
    if not len(rows):
        return np.zeros((0, 3))
    low, size = solid.low[rows], solid.size[rows]
    order = np.lexsort((low[:, 1], low[:, 0]))
    low, high = low[order], (low + size[:, None])[order]
    first = np.flatnonzero(np.concatenate([[True], (np.diff(low[:, :2], axis=0) != 0).any(axis=1)]))
    bottom, top = np.minimum.reduceat(low[:, 2], first), np.maximum.reduceat(high[:, 2], first)
    widest = np.maximum.reduceat(high[:, :2], first, axis=0)
    corners = [np.column_stack([low[first, :2], bottom]), np.column_stack([widest, top])]
    return np.asarray(solid.origin_mm + solid.voxel_mm * np.concatenate(corners), np.float64)
