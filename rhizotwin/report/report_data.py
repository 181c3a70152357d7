"""Result with everything that its report and its figures show."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from rhizotwin.drawing import surface_mesh
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

TRIANGLES, TRIANGLES_OF_MANY = 80_000, 24_000
"""Maximum numbers of surface triangles in a report of one result (about 1.7 MB) and in a report of many results."""


@dataclass(frozen=True)
class ReportData:
    """Result with all data that a report needs. The surface is reduced and rendered once, for page and figures."""

    folder: Path
    summary: dict[str, Any]
    roots: tuple[Root, ...]
    full_surface: Mesh
    traits: Traits
    dataset: Dataset | None
    triangles: int = TRIANGLES
    """Maximum number of triangles of ``surface``."""

    @classmethod
    def read(cls, folder: Path, dataset: Dataset | Path | None = None, *, triangles: int = TRIANGLES) -> ReportData:
        """Read a result folder.

        Parameters
        ----------
        folder : Path
            Result folder.
        dataset : Dataset, path or None
            Dataset of the result. None: the dataset recorded in the result, if it still exists.
        triangles : int
            Maximum number of triangles of the displayed surface.

        Raises
        ------
        UserError
            If a file of the result is missing, or the given dataset is not that of the result.
        """
        summary = result_files.read_summary(folder)
        roots, surface = result_files.read_roots(folder), result_files.read_mesh(folder / "shape.ply")
        traits = stored_traits.of_summary(summary, surface, roots)
        return cls(folder, summary, roots, surface, traits, result_files.find_dataset(folder, summary, dataset), triangles)

    @classmethod
    def of(cls, result: Result, folder: Path, dataset: Dataset | None) -> ReportData:
        """Return the data of a result that was written to a folder, without reading and measuring it again."""
        summary = result_files.read_summary(folder)
        return cls(folder, summary, tuple(result.roots), result.solid.surface, result.measured, dataset)

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
            reduced = surface_mesh.simplify(self.full_surface, self.triangles)
        except ValueError:  # the surface is not closed
            return surface_mesh.simplify(surface_mesh.close(self.full_surface), self.triangles)
        return surface_mesh.close(reduced)

    @cached_property
    def renderings(self) -> list[sides.Rendering]:
        """Renderings of the surface from the front and from the side. Empty if there is no surface."""
        return sides.render(self.surface)
