"""Fit corrected roots to the pictures again. The topology of the roots is not changed."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rhizotwin import engine
from rhizotwin.corrections.lines import Lines
from rhizotwin.corrections.state import Refit, Refitted
from rhizotwin.recon.results import result_traits
from rhizotwin.scenes.dataset import Dataset
from rhizotwin.scenes.errors import UserError
from rhizotwin.stored import result_files
from rhizotwin.stored.stored_cameras import Cameras

if TYPE_CHECKING:  # imported at run time only after the engine has been started
    from rhizotwin.recon.tubes.tubes import Tubes

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


def fitter(result_folder: Path, dataset: Dataset) -> Refit:
    """Create a function that fits roots to the pictures of a dataset.

    It uses the silhouettes that are stored with the result, and does not change thick roots. The first point of a
    lateral remains on its parent. The errors below are raised when the function is called.

    Raises
    ------
    UserError
        If roots are translucent, or the result contains no coverage of a picture.
    """

    def fit(lines: Lines) -> dict[int, Refitted]:
        summary = result_files.read_summary(result_folder)
        if summary.get("root_mu_per_mm") is not None:
            raise UserError("translucent roots cannot be refitted, because the result does not contain the transmitted light")
        if not lines:
            raise UserError("the result has no roots to refit")
        engine.start("auto")
        from rhizotwin.recon.coverage.evidence import Evidence
        from rhizotwin.recon.optics.projection import ViewBank
        from rhizotwin.recon.tubes import root_light, tube_fit
        from rhizotwin.recon.tubes import tubes as tube_shapes
        from rhizotwin.stored.load import load_result

        cameras = Cameras.of(dataset, summary)
        kept = load_result(result_folder).silhouettes
        missing = [file for file in cameras.files if file not in kept]
        if missing or not cameras.files:
            raise UserError(
                f"{result_folder} contains no silhouette of {missing[0] if missing else 'any picture'}; repeat the reconstruction"
            )
        seen = Evidence.from_silhouettes(ViewBank.pack(cameras.views, cameras.optics), [kept[file] for file in cameras.files])
        thick_mm = result_traits.THICK_CELLS * result_files.finest_mm(summary)
        tubes, fixed, numbers = as_tubes(lines, thick_mm)
        fitted = tube_fit.fit(seen, tubes, fixed, light=root_light.parameters(seen)).tubes
        centre = np.where(fixed[:, None], tubes.centre_mm, fitted.centre_mm)
        fitted = tube_shapes.with_geometry(fitted, centre, np.where(fixed, tubes.radius_mm, fitted.radius_mm))
        found = {}
        for k, number in enumerate(numbers):
            nodes = fitted.branches[k]
            stays = fixed[nodes].copy()
            if k and not stays[1:].all():
                stays[0] = False
            found[number] = Refitted(fitted.centre_mm[nodes], 2.0 * fitted.radii(k), stays)
        return found

    return fit


def as_tubes(lines: Lines, thick_mm: float) -> tuple[Tubes, Mask, list[int]]:
    """Convert all roots to a single tree of tubes that can be fitted to the pictures.

    Parameters
    ----------
    thick_mm : float
        Maximum radius of a node that is fitted, mm.

    Returns
    -------
    tubes : Tubes
        Tubes, sorted with parents before children.
    fixed : (N,) bool array
        Whether a node is excluded from the fit.
    numbers : list of int
        Number of the root of each branch.
    """
    from rhizotwin.recon.tubes.tubes import Tubes

    waiting = sorted((number for number, line in lines.items() if line.parent not in lines), key=lambda k: -lines[k].length_mm)
    numbers: list[int] = []
    while waiting:
        number = waiting.pop(0)
        numbers.append(number)
        waiting += [k for k, line in lines.items() if line.parent == number]
    centres = list[Array]()
    radii = list[Array]()
    fixed = list[Mask]()
    branches = list[NDArray[np.int64]]()
    count = 0
    for place, number in enumerate(numbers):
        line = lines[number]
        own = line.points_mm if place == 0 or line.parent not in lines else line.points_mm[1:]
        width = line.diameters_mm[-len(own) :] / 2.0
        stays = width > thick_mm
        nodes = count + np.arange(len(own))
        if place and line.parent in lines:
            above = branches[numbers.index(line.parent)]
            parent = lines[line.parent]
            nearest = int(np.linalg.norm(parent.points_mm - line.points_mm[0], axis=1).argmin())
            nodes = np.concatenate([above[nearest : nearest + 1], nodes])
        elif place:
            stays = stays.copy()
            stays[0] = True  # the first node of a root without a parent is part of no branch
        centres.append(own)
        radii.append(width)
        fixed.append(stays)
        branches.append(nodes)
        count += len(own)
    return Tubes(np.concatenate(centres), np.concatenate(radii), tuple(branches)), np.concatenate(fixed), numbers
