"""Result in the viewer, with its corrections, pictures, surface and true surface. They are loaded on first use."""

from __future__ import annotations

import threading
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rhizotwin.corrections.lines import Lines
from rhizotwin.corrections.session import Session
from rhizotwin.corrections.state import Refitted
from rhizotwin.drawing import surface_mesh
from rhizotwin.drawing.through_water import Pictures
from rhizotwin.recon.results.parts import Mesh
from rhizotwin.scenes.dataset import Dataset
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.traits import Traits
from rhizotwin.stored import result_files

TRIANGLES = 100_000
"""Maximum number of triangles of a displayed surface."""
FARTHEST_MM = 1.0
"""Distance to the true surface at the upper end of the colour scale, mm."""


class Shown:
    """Result with all data that the viewer can display."""

    def __init__(self, folder: Path, dataset_folder: Path | None, *, temporary: bool = False) -> None:
        self._folder, self._given = folder, dataset_folder
        self.session = Session(folder, refit=self._refit, temporary=temporary)
        self._loading = threading.Lock()
        self._mesh: tuple[object, Mesh] | None = None
        self._surface: tuple[object, Mesh] | None = None
        self._traits: tuple[object, Traits] | None = None

    @property
    def name(self) -> str:
        """Return the name of the result's folder."""
        return self.session.folder.name or str(self.session.folder)

    @cached_property
    def dataset(self) -> Dataset | None:
        """Return the given dataset. If none is given, return the dataset recorded in the result.

        Return None if the recorded dataset no longer exists or has changed.
        """
        # does not use the session, because saved refits need the dataset while the session is opened
        return result_files.find_dataset(self._folder, result_files.read_summary(self._folder), self._given)

    @cached_property
    def pictures(self) -> Pictures | None:
        """Return the pictures with their calibrated cameras. Return None if the dataset is not available."""
        return None if self.dataset is None else Pictures.of(self.dataset, self.session.summary)

    @property
    def truth_file(self) -> Path | None:
        """Return the mesh file of the true solid. Return None if the dataset is not available or was not simulated."""
        file = None if self.dataset is None else self.dataset.folder / "truth" / "specimen.ply"
        return file if file is not None and file.is_file() else None

    @cached_property
    def truth(self) -> Mesh | None:
        """Return the true solid, closed and simplified.

        Return None if the dataset is not available or was not simulated.
        """
        return None if self.truth_file is None else _simplify_for_display(result_files.read_mesh(self.truth_file))

    def surface(self) -> Mesh:
        """Return the surface after corrections, closed and simplified."""
        with self._loading:
            edits = self.session.log.edits
            if self._surface is None or self._surface[0] != edits:
                self._surface = edits, _simplify_for_display(self._full_mesh())
            return self._surface[1]

    def traits(self) -> Traits:
        """Measure the traits after corrections. They are the same as in the report of the corrected result."""
        from rhizotwin.corrections import corrected
        from rhizotwin.stored import stored_traits

        with self._loading:
            edits = self.session.log.edits
            if self._traits is None or self._traits[0] != edits:
                mesh = self._full_mesh()
                summary = corrected.summarise(self.session, mesh) if edits else self.session.summary
                self._traits = edits, stored_traits.of_summary(summary, mesh, self.session.state.roots() if edits else self.session.roots)
            return self._traits[1]

    def _refit(self, lines: Lines) -> dict[int, Refitted]:
        """Fit roots to the pictures."""
        from rhizotwin.corrections.refit import fitter  # loads the engine

        if self.dataset is None:
            raise UserError("refitting needs the pictures; restart the viewer with 'rhizotwin view RESULT DATASET'")
        return fitter(self._folder, self.dataset)(lines)

    def _full_mesh(self) -> Mesh:
        """Return the surface after corrections with all its triangles."""
        from rhizotwin.corrections import corrected

        edits = self.session.log.edits
        if self._mesh is None or self._mesh[0] != edits:
            self._mesh = edits, corrected.read_mesh(self.session) if edits else result_files.read_mesh(self.session.folder / "shape.ply")
        return self._mesh[1]

    def distance_colours(self, mesh: Mesh) -> NDArray[np.uint8]:
        """Return colours (V, 3) that show the distances of vertices to the true surface.

        The colour scale extends from 0 (violet) to `FARTHEST_MM` (yellow).
        """
        from rhizotwin.drawing import root_colours
        from rhizotwin.scoring import surface_distance

        if self.truth is None:
            raise UserError(
                f"{self.name} cannot be compared with the truth, because the scan was not simulated or its dataset was not found"
            )
        away = surface_distance.distances(mesh.vertices_mm, self.truth.vertices_mm, self.truth.faces)
        return root_colours.scale_colours(away / FARTHEST_MM)


def _simplify_for_display(mesh: Mesh) -> Mesh:
    return surface_mesh.simplify(surface_mesh.close(mesh), TRIANGLES)
