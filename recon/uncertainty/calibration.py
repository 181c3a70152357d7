"""Calibration of the 90 % intervals: factors on their half-widths, measured on random scans with known truth.

The error budget and the comparison of the roots with the pictures determine the shape of an interval. A factor for each
trait and regime of scans corrects its width. The factors are those of split conformal prediction (Lei et al. 2018,
Journal of the American Statistical Association 113:1094, section 2.2): quantiles of |true - found| / half-width over
calibration scans, at which nine in ten further scans of the regime hold the truth. ``calibration.json`` contains them;
`benchmarks.intervals` measures them (docs/intervals.md).
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import Any

TABLE = Path(__file__).with_name("calibration.json")
VIEWS = (12, 60)
"""Range of the number of views of the calibration scans."""
PX_A_MM = (1.4, 4.0)
"""Range of the scale at the centre of the water, px/mm, in the calibration scans (pictures 320 to 800 px wide)."""
INCONSISTENT = 0.1
"""Minimum fraction of the coverage outside the hull of all views at which the views count as inconsistent."""
THIN_PX = 1.3
"""Mean width of the roots, px, below which they count as thin. The blur of a pixel then changes the coverage along most
of their length."""
HIDDEN = 0.02
"""Minimum ratio of the term ``occluded`` to the volume at which a part of the roots counts as hidden."""


@dataclass(frozen=True, kw_only=True)
class Calibration:
    """Factors on the half-widths of a scan's intervals."""

    regime: str | None = None
    """Name of the regime; None for a scan unlike the calibration scans, whose intervals are not calibrated."""
    factors: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))
    """Factor by trait: volume_mm3, total_length_mm, tips and mean_diameter_mm."""

    def factor(self, trait: str) -> float:
        """Return the factor of a trait; 1 if it is not calibrated."""
        return self.factors.get(trait, 1.0)

    @property
    def text(self) -> str:
        """Regime of the calibration, in a phrase."""
        if self.regime is None or not self.factors:
            return "not calibrated: no calibration scans of this kind"
        return f"calibrated on scans with the regime '{self.regime}'"

    def plain(self) -> dict[str, object]:
        """Return the calibration as JSON values."""
        return {"regime": self.regime, "factors": dict(self.factors)}

    @staticmethod
    def from_plain(stored: Mapping[str, Any] | None) -> Calibration:
        """Return a calibration from JSON values; not calibrated for None, as in results of earlier versions."""
        return NOT_CALIBRATED if stored is None else Calibration(regime=stored["regime"], factors=dict(stored["factors"]))


NOT_CALIBRATED = Calibration()
"""Calibration of scans unlike the calibration scans, and of volumes without a budget."""


def find_calibration(*, views: int, px_a_mm: float, missed: float, translucent: bool, width_mm: float | None, hidden: float) -> Calibration:
    """Return the calibration of a scan of roots in a canister with markers.

    The first regime that applies is used, in the order of the parameters from ``missed`` on.

    Parameters
    ----------
    views : int
        Number of views.
    px_a_mm : float
        Scale at the centre of the water, px/mm.
    missed : float
        Fraction of the coverage outside the hull of all views.
    translucent : bool
        Whether the attenuation of the roots was estimated.
    width_mm : float or None
        Mean diameter of the roots, mm. None if there are only solids.
    hidden : float
        Ratio of the budget's term ``occluded`` to the volume.
    """
    if not (VIEWS[0] <= views <= VIEWS[1] and PX_A_MM[0] <= px_a_mm <= PX_A_MM[1]):
        return NOT_CALIBRATED
    regimes = {
        "inconsistent views": missed > INCONSISTENT,
        "translucent roots": translucent,
        "thin roots": width_mm is not None and width_mm * px_a_mm < THIN_PX,
        "hidden parts": hidden >= HIDDEN,
        "clear": True,
    }
    regime = next(name for name, applies in regimes.items() if applies)
    return Calibration(regime=regime, factors=_table().get(regime, {}))


@cache
def _table() -> Mapping[str, Mapping[str, float]]:
    """Return the committed factors by regime and trait."""
    return dict(json.loads(TABLE.read_text(encoding="utf-8"))["factors"])
