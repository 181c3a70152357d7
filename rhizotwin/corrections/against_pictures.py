"""Compare a corrected shape with the pictures and estimate its missing and surplus fractions."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from rhizotwin import engine
from rhizotwin.corrections.session import Session
from rhizotwin.recon.results.parts import Json
from rhizotwin.recon.settings import TrustSettings
from rhizotwin.recon.uncertainty.budget import Term
from rhizotwin.recon.uncertainty.checks import Check, judge, worst
from rhizotwin.scenes.dataset import load_dataset
from rhizotwin.scenes.errors import UserError
from rhizotwin.stored import result_files
from rhizotwin.stored.stored_cameras import Cameras

if TYPE_CHECKING:  # imported at run time only after the engine has been started
    from rhizotwin.recon.hull.agreement import Agreement

Array = NDArray[np.float64]

_NAME: Literal["corrections"] = "corrections"
"""Name of the check, and of the term in the error budget."""
_VIEWS = 8
"""Number of views that are compared. They are spread over one revolution of the turntable, as in the reconstruction."""


@dataclass(frozen=True)
class Comparison:
    """Disagreement between the shape and the pictures that is due to manual corrections."""

    missed: float
    """Increase of the fraction of a silhouette that the shape does not explain. It is the maximum over the compared
    views, because other roots may hide a deleted part in some views."""
    surplus: float
    """Increase of the fraction of the shape's volume that lies where the pictures show no roots."""

    def __add__(self, later: Comparison) -> Comparison:
        """Return the disagreement due to these and later corrections, which is at most the sum of both."""
        return Comparison(missed=min(1.0, self.missed + later.missed), surplus=min(1.0, self.surplus + later.surplus))

    def check(self, trust: TrustSettings = TrustSettings()) -> Check:
        """Check that the missing and surplus fractions do not exceed the limit ``trust.unexplained``."""
        lacking = f"because of the corrections, the shape no longer explains {100.0 * self.missed:.1f} % of the roots in a picture"
        beyond = f"because of the corrections, another {100.0 * self.surplus:.1f} % of the shape lies where the pictures show no roots"
        advice = "compare the corrected shape with the pictures in 'rhizotwin view', and undo wrong corrections"
        return worst(
            judge(_NAME, self.missed, "share", trust.unexplained, lacking, advice),
            judge(_NAME, self.surplus, "share", trust.unexplained, beyond, advice),
        )

    def term(self, before_mm3: float, after_mm3: float) -> Term:
        """Return the contribution of the corrections to the error budget of the volume, mm3.

        Area fractions in the pictures are used as volume fractions.

        Parameters
        ----------
        before_mm3, after_mm3 : float
            Volume before the first and after the last correction, mm3.
        """
        why = "some corrections contradict the pictures"
        return Term(name=_NAME, less_mm3=self.surplus * after_mm3, more_mm3=self.missed * before_mm3, why=why)


def recorded(summary: Json) -> Comparison:
    """Return the disagreement that a corrected result records in its error budget, see `Comparison.term`.

    It is zero if the result was not corrected.
    """
    terms = [term for term in summary["volume_budget"] if term.get("name") == _NAME]
    after_mm3 = float(summary["volume_mm3"])
    before_mm3 = float((summary.get("edits") or {}).get("volume_before_mm3", after_mm3))
    return Comparison(
        missed=sum(term["more_mm3"] for term in terms) / before_mm3 if before_mm3 > 0.0 else 0.0,
        surplus=sum(term["less_mm3"] for term in terms) / after_mm3 if after_mm3 > 0.0 else 0.0,
    )


def compare(session: Session, dataset_folder: Path | None) -> Comparison:
    """Compare the shape before and after the corrections with the silhouettes stored with the result.

    Parameters
    ----------
    session : Session
        Result and its corrections.
    dataset_folder : path or None
        Folder of the dataset. None: the dataset recorded in the result.

    Raises
    ------
    UserError
        If the dataset is missing, is not that of the result, or the result contains no silhouettes.
    """
    summary = session.summary
    dataset = load_dataset(dataset_folder or Path(str(summary["dataset"])))
    result_files.check_same_scan(summary["dataset_sha256"], summary["scene"], session.folder, dataset)
    engine.ensure("auto")
    from rhizotwin.recon.hull import agreement, carve
    from rhizotwin.recon.optics.projection import ViewBank
    from rhizotwin.stored.load import load_result

    cameras = Cameras.of(dataset, summary)
    kept = load_result(session.folder).silhouettes
    known = [k for k, file in enumerate(cameras.files) if file in kept]
    if not known:
        raise UserError(f"{session.folder} contains no silhouettes; repeat the reconstruction")
    some = [known[k] for k in carve.spread(len(known))[:_VIEWS]]
    bank = ViewBank.pack([cameras.views[k] for k in some], cameras.optics)
    silhouettes = [kept[cameras.files[k]] for k in some]

    def agree(low: NDArray[np.integer], size: NDArray[np.integer], volume_mm3: Array) -> tuple[Array, float]:
        there = volume_mm3 > 0.0
        if not there.any():
            return np.ones(len(some)), 0.0
        leaves = session.leaves
        middles = leaves.origin_mm + leaves.voxel_mm * (low[there] + 0.5 * size[there, None])
        found = agreement.compare(bank, silhouettes, middles, leaves.voxel_mm * size[there].astype(np.float64))
        return found.missed_share, _surplus(found, volume_mm3[there])

    measured = session.measure()
    leaves = session.leaves
    as_found = leaves.occupancy.astype(np.float64) * leaves.size.astype(np.float64) ** 3
    missed, surplus = agree(leaves.low, leaves.size, as_found)
    missed_now, surplus_now = agree(measured.solid.low, measured.solid.size, measured.volumes_mm3)
    return Comparison(missed=max(0.0, float((missed_now - missed).max())), surplus=max(0.0, surplus_now - surplus))


def _surplus(found: Agreement, volume: Array) -> float:
    """Return the fraction of the visible volume that lies outside the silhouettes, averaged over the views."""
    seen = found.sees @ volume
    return float(np.mean((found.excluded & found.sees) @ volume / np.maximum(seen, 1e-12)))
