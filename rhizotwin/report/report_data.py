"""Result with everything that its report and its figures show."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from rhizotwin.drawing import root_mesh, surface_mesh
from rhizotwin.recon.results import assessments
from rhizotwin.recon.results.parts import Mesh
from rhizotwin.recon.results.result import Result
from rhizotwin.report import sides
from rhizotwin.scenes import solution, subject
from rhizotwin.scenes.assessment import Assessment
from rhizotwin.scenes.dataset import Dataset
from rhizotwin.scenes.rsml import Root
from rhizotwin.scenes.subject import Subject
from rhizotwin.scenes.traits import Traits
from rhizotwin.stored import result_files, stored_traits

TRIANGLES = 80_000
"""Maximum number of surface triangles in a report (about 1.7 MB)."""
SMALL_PX = 480
"""Height of the picture of the shape in a report of several results, pixels."""


@dataclass(frozen=True)
class ReportData:
    """Result with all data that a report needs. Surface, roots and renderings are loaded or computed on first use."""

    folder: Path
    summary: dict[str, Any]
    dataset: Dataset | None
    result: Result | None = None
    """Result that was written to the folder, so that it is not read again."""

    @classmethod
    def read(cls, folder: Path, dataset: Dataset | Path | None = None) -> ReportData:
        """Read a result folder.

        Parameters
        ----------
        folder : Path
            Result folder.
        dataset : Dataset, path or None
            Dataset of the result. None: the dataset recorded in the result, if it still exists.

        Raises
        ------
        UserError
            If a file of the result is missing, or the given dataset is not that of the result.
        """
        summary = result_files.read_summary(folder)
        return cls(folder, summary, result_files.find_dataset(folder, summary, dataset))

    @classmethod
    def of(cls, result: Result, folder: Path, dataset: Dataset | None) -> ReportData:
        """Return the data of a result that was written to a folder."""
        return cls(folder, result_files.read_summary(folder), dataset, result)

    @cached_property
    def roots(self) -> tuple[Root, ...]:
        """Roots with their centre lines."""
        return result_files.read_roots(self.folder) if self.result is None else tuple(self.result.roots)

    @cached_property
    def full_surface(self) -> Mesh:
        """Surface with all triangles."""
        return result_files.read_mesh(self.folder / "shape.ply") if self.result is None else self.result.solid.surface

    @cached_property
    def traits(self) -> Traits:
        """Traits of all plants together."""
        return stored_traits.read(self.folder) if self.result is None else self.result.measured

    @property
    def name(self) -> str:
        """Name of the scene."""
        return str(self.summary["scene"])

    @cached_property
    def assessed(self) -> dict[str, Assessment]:
        """Assessment of each trait, keyed by field."""
        return assessments.assess(self.summary, self.traits)

    @property
    def subject(self) -> Subject:
        """Plants of the scan."""
        return subject.from_summary(self.summary, str(self.folder / "result.json"))

    @property
    def solution(self) -> str:
        """Nutrient solution. The text is empty if it is unknown."""
        return str(solution.from_summary(self.summary, str(self.folder / "result.json")))

    @cached_property
    def surface(self) -> Mesh:
        """Closed surface with a reduced number of triangles."""
        try:
            reduced = surface_mesh.simplify(self.full_surface, TRIANGLES)
        except ValueError:  # the surface is not closed
            return surface_mesh.simplify(surface_mesh.close(self.full_surface), TRIANGLES)
        return surface_mesh.close(reduced)

    @cached_property
    def renderings(self) -> list[sides.Rendering]:
        """Renderings of the surface from the front and from the side. Empty if there is no surface."""
        return sides.render(self.surface)

    def small_picture(self) -> NDArray[np.uint8] | None:
        """Return a picture (H, W, 3) of the shape, or None if there is no shape.

        The stored picture is returned if it is not older than the surface. If no surface is stored, the roots are drawn
        as tubes.
        """
        stored, surface = self.folder / "pictures" / "shape.png", self.folder / "shape.ply"
        has_surface = surface.is_file()
        if stored.is_file() and not (has_surface and stored.stat().st_mtime < surface.stat().st_mtime):
            picture = result_files.read_shape_picture(self.folder)
            if picture is not None:
                scale = min(1.0, SMALL_PX / len(picture))
                return np.asarray(cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), np.uint8)[..., ::-1]
        if not has_surface and not self.roots:
            return None
        drawn = sides.render(self.full_surface if has_surface else root_mesh.unite_tubes(self.roots), height_px=SMALL_PX)
        return sides.overview(drawn) if drawn else None
