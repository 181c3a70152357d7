"""Verify a result: render its shape with the twin, and compare it with pictures that the reconstruction did not use."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import cv2
import numpy as np

from rhizotwin.recon.coverage.silhouettes import Image
from rhizotwin.recon.results.parts import Json, picture_path
from rhizotwin.recon.results.result import Result
from rhizotwin.recon.settings import CalibrationSettings, TrustSettings
from rhizotwin.scenes import atomic
from rhizotwin.scenes.dataset import Dataset
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.monitor import Monitor
from rhizotwin.stored import result_files
from rhizotwin.verification import canister_width, structures
from rhizotwin.verification.canister_width import CanisterWidth
from rhizotwin.verification.pictures import Picture, measure_pictures
from rhizotwin.verification.refraction_error import Equations, RefractionError, worst_first
from rhizotwin.verification.structures import Comparison, Structure
from rhizotwin.verification.synthesis import Synthesis, true_camera

BRANCH_SHARE = 0.02
"""Minimum length of missing and surplus roots together that is an error of the result, as a fraction of the visible
root length. It is two fifths of the smallest branch that must be found (5 %): other roots hide the rest of it."""
_MOST_NAMED = 3
"""Maximum number of places that the reason names for missing or surplus roots."""


@dataclass(frozen=True, kw_only=True)
class Verification:
    """Agreement of a result with pictures, rendered by the twin."""

    scene: str
    """Name of the scene."""
    held_out: bool
    """Whether the pictures were held out of the reconstruction. Otherwise they were used, and the test is weaker."""
    explained: dict[str, float]
    """Fraction of the root pixels of each picture that the rendered roots explain, keyed by file name."""
    displaced_px: dict[str, tuple[float, float]]
    """Displacement of the roots in each picture relative to the rendered roots, px, keyed by file name."""
    length_mm: float
    """Length of the centre lines in the picture that shows most of them, mm."""
    structures: tuple[Structure, ...]
    """Missing and surplus parts of roots, the longest ones first."""
    refraction: RefractionError
    canister: CanisterWidth | None
    """Width of the canister in the pictures; None if its edges could not be measured."""

    @property
    def problems(self) -> tuple[str, ...]:
        """Return the reasons why result and pictures disagree. The tuple is empty if they agree."""
        return (*self._geometry_problems(), *self._branch_problems())

    @property
    def agrees(self) -> bool:
        """Return whether result and pictures agree."""
        return not self.problems

    @property
    def verdict(self) -> str:
        """Return the verdict with its reason, in one sentence."""
        pictures = f"{len(self.explained)} {'pictures that the reconstruction did not use' if self.held_out else 'used pictures'}"
        if self.problems:
            return f"the result disagrees with {pictures}: {'; '.join(self.problems)}"
        limit = self.refraction.detectable
        refraction = f"the refraction is consistent (errors of the index above {limit:.1g} would show)"
        if self.refraction.index is None:
            refraction = "the refraction could not be tested, because there are too few roots"
        return (
            f"the result agrees with {pictures}: less than {100.0 * BRANCH_SHARE:g} % of the visible root length is missing or "
            f"surplus, and {refraction}"
        )

    def _geometry_problems(self) -> list[str]:
        """Return the errors of cameras, canister and water."""
        found = []
        moved = {file: float(np.hypot(*shift)) for file, shift in self.displaced_px.items()}
        limit = CalibrationSettings().worst_px
        found += [f"the camera of {file} is wrong, its roots are displaced by {px:.1f} px" for file, px in moved.items() if px > limit]
        if self.canister is not None and self.canister.is_wrong:
            found.append(
                f"the width of the canister in the pictures differs by {100.0 * self.canister.error:+.1f} % from the rendered one, so that "
                "the size of the marker strip or the radius of the canister is wrong"
            )
        elif self.refraction.is_wrong:
            found.append(f"the refraction is wrong, which one of these errors explains: {worst_first(self.refraction.estimates)}")
        return found

    def _branch_problems(self) -> list[str]:
        """Return the missing and surplus branches, and the fraction of roots that is not explained."""
        found = []
        if sum(one.length_mm for one in self.structures) > BRANCH_SHARE * self.length_mm:
            for kind, what in (("missing", "are missing in the result"), ("surplus", "of the result are not in the pictures")):
                if parts := [one for one in self.structures if one.kind == kind]:
                    length_mm = sum(one.length_mm for one in parts)
                    share = 100.0 * length_mm / self.length_mm
                    found.append(f"{length_mm:.0f} mm of roots ({share:.0f} % of the visible length) {what}: {_list(parts)}")
        share = float(np.mean(list(self.explained.values())))
        if 1.0 - share > TrustSettings().unexplained[1]:
            found.append(f"only {100.0 * share:.0f} % of the root pixels are explained")
        return found

    def to_dict(self) -> Json:
        """Convert the verification to values that the json module can write."""
        return {"agrees": self.agrees, "verdict": self.verdict, "problems": list(self.problems), **asdict(self)}

    def table(self) -> str:
        """Return the verification as text."""
        lines = [self.verdict[0].upper() + self.verdict[1:] + "."]
        if not self.held_out:
            lines.append("All pictures were used; repeat the reconstruction with --hold-out 5 for a stronger test.")
        lines += [f"  {file}: {100.0 * share:.1f} % of the root pixels explained" for file, share in self.explained.items()]
        if self.refraction.estimates:
            lines.append(f"  refraction, as an error of one parameter: {worst_first(self.refraction.estimates)}")
        if self.canister is not None:
            lines.append(f"  width of the canister: {100.0 * self.canister.error:+.2f} % (+- {100.0 * self.canister.sigma:.1g} %)")
        return "\n".join(lines)


def _list(parts: Sequence[Structure]) -> str:
    """Return the places of the longest parts as text."""
    named = []
    for one in parts[:_MOST_NAMED]:
        x, y, z = one.centre_mm
        file, (column, row) = next(iter(one.pixels.items()))
        named.append(f"{one.length_mm:.0f} mm at x {x:.0f}, y {y:.0f}, z {z:.0f} mm (column {column:.0f}, row {row:.0f} of {file})")
    return ", ".join(named)


def verify(result: Result, dataset: Dataset, *, folder: Path | None = None, monitor: Monitor) -> Verification:
    """Render a result with the twin, and compare it with pictures that the reconstruction did not use.

    Parameters
    ----------
    result : Result
        Result of the dataset, preferably reconstructed with ``hold_out`` pictures.
    dataset : Dataset
        Dataset of the result.
    folder : Path, optional
        Folder for ``verify.json`` and the residual pictures ``residuals/NAME.png``: 128 where picture and rendering
        agree, brighter where the picture shows a root that the result lacks, and darker where a root of the result is
        not in the picture.
    monitor : Monitor
        Progress monitor.

    Raises
    ------
    UserError
        If the dataset is not that of the result or contains masks, or if the result has no surface.
    """
    result_files.check_same_scan(result.dataset_sha256, result.scene, "the result", dataset)
    if not len(result.solid.surface.faces):
        raise UserError("the result has no surface that could be rendered; repeat the reconstruction")
    pictures, optics, is_held_out = measure_pictures(result, dataset, monitor=monitor)
    with monitor.stage("verify"):
        synthesis = Synthesis(result, dataset.scene)
        equations = Equations(result, dataset.scene, synthesis)
        compared = list[Comparison]()
        edges = []
        with monitor.steps("verify", len(pictures), "picture") as step:
            for picture in pictures:
                camera = true_camera(picture.camera, dataset.scene)
                rendered = synthesis.opacity(camera)
                equations.add(picture, rendered)
                edges.append(canister_width.measure_edges(picture.light.astype(np.float32), *synthesis.canister(camera)))
                if picture.is_compared and math.isfinite(scale := synthesis.mm_per_px(camera, _middle(rendered))):
                    compared.append(structures.compare(picture, rendered, scale))
                step()
        if not compared:
            raise UserError("no picture shows the place of the reconstructed roots through the water; the cameras or the shape are wrong")
        verification = Verification(
            scene=result.scene,
            held_out=is_held_out,
            explained={one.picture.camera.file: one.explained for one in compared},
            displaced_px={one.picture.camera.file: _displacement(one.picture, one.rendered) for one in compared},
            length_mm=_visible_mm(compared),
            structures=structures.find_structures(compared, synthesis, dataset.scene, optics),
            refraction=equations.solve(),
            canister=canister_width.combine(edges),
        )
    if folder is not None:
        _write(folder, verification, compared)
    return verification


def _middle(rendered: Image) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """Return the middle pixel (2,) of the rendered roots."""
    there = np.argwhere(rendered > 0.0)
    height, width = rendered.shape
    return np.asarray(there.mean(axis=0)[::-1] if len(there) else [0.5 * width, 0.5 * height], np.float64)


def _displacement(picture: Picture, rendered: Image) -> tuple[float, float]:
    """Return the displacement of the roots in a picture relative to the rendered roots, px."""
    shown = np.where(picture.usable, picture.opacity, 0.0)
    made = np.where(picture.usable, rendered, 0.0)
    (x, y), _ = cv2.phaseCorrelate(made.astype(np.float64), shown.astype(np.float64))
    return float(x), float(y)


def _visible_mm(compared: Sequence[Comparison]) -> float:
    """Return the length of the centre lines in the picture that shows most of them, mm."""
    return max(structures.line_length_px(one.picture.smooth > one.picture.trace_level(one.rendered)) * one.mm_per_px for one in compared)


def _write(folder: Path, verification: Verification, compared: Sequence[Comparison]) -> None:
    """Write the residual pictures, and last the numbers."""
    for one in compared:
        residual = np.where(one.picture.usable, one.picture.opacity - one.rendered, 0.0)
        grey = np.clip(np.rint(128.0 + 127.0 * residual), 0.0, 255.0).astype(np.uint8)
        atomic.write_image(picture_path(folder / "residuals", one.picture.camera.file), grey)
    atomic.write_json(folder / "verify.json", verification.to_dict())
