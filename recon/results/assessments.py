"""Reliability of every trait of a result, from the intervals and verdicts in ``result.json``."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from rhizotwin.recon.results import reasons
from rhizotwin.recon.results.parts import Json
from rhizotwin.recon.uncertainty.checks import NO_VOLUME
from rhizotwin.scenes.assessment import NO_INTERVAL, Assessment
from rhizotwin.scenes.trait_table import DEFINITIONS
from rhizotwin.scenes.traits import Traits

Pair = tuple[float, float]


_DERIVED = {
    "specific_root_length_m_per_g": {"total_length_mm": 1},
    "tissue_density_g_per_ml": {"volume_mm3": -1},
    "surface_mm2": {"total_length_mm": 1, "mean_diameter_mm": 1},
    "median_diameter_mm": {"mean_diameter_mm": 1},
    "roots": {"tips": 1},
    "branch_points": {"tips": 1},
    "depth_mm": {"total_length_mm": 1},
    "width_mm": {"total_length_mm": 1},
}
"""Traits that are proportional to powers of others: each root has a tip, and each lateral a point of emergence. Depth
and width lack at most the fraction that the roots lack, besides the depth that the net pot hides."""
_PART_IS_WIDE = "the 90 % interval is too wide for a plant of this size, since it includes the uncertainty of all plants in the canister"


def assess(summary: Json, traits: Traits, *, volume_interval_mm3: Pair | None = None) -> dict[str, Assessment]:
    """Return the assessment of each trait, keyed by its field in `Traits`.

    Volume, length, tips and mean diameter have their own intervals, from which those of the traits in `_DERIVED`
    are derived. All other traits have no interval. That of ``length_by_order_mm`` is the change of each
    order by ambiguous forks. Traits without an interval are not reliable if the volume is not reliable. If a
    length, number of tips or mean diameter of the whole scan is not reliable, that of each of its plants is not
    reliable either.

    Parameters
    ----------
    summary : Json
        Contents of ``result.json``.
    traits : Traits
        Traits of the whole result, or of one of several plants.
    volume_interval_mm3 : (float, float), optional
        Interval of the plant's volume, mm3, if ``traits`` are those of one of several plants. In this case, only the
        volume has an interval.
    """
    reason = str(summary["volume_verdict"]).removeprefix(NO_VOLUME)
    codes = reasons.reasons_for_volume(summary)
    refused = Assessment(verdict="not reliable", reason=f"the scan is not reliable: {reason}", codes=codes)
    is_assessed = bool(summary["volume_budget"])
    found = dict.fromkeys((d.field for d in DEFINITIONS), refused if is_assessed and not summary["volume_trusted"] else NO_INTERVAL)
    if is_assessed:
        low, high = summary["volume_interval_mm3"] if volume_interval_mm3 is None else volume_interval_mm3
        found["volume_mm3"] = _judge(summary["volume_trusted"], (low, high), reason, codes)
        if summary["volume_trusted"] and volume_interval_mm3 and reasons.is_wide(summary, traits.volume_mm3, volume_interval_mm3):
            found["volume_mm3"] = _judge(False, volume_interval_mm3, _PART_IS_WIDE, (reasons.WIDE,))
    for one in summary.get("estimates") or ():
        low, high = one["interval"]
        judged = _judge(one["trusted"], (low, high), one["verdict"], reasons.reasons_for_estimate(summary, one))
        if volume_interval_mm3 is None:
            found[one["name"]] = judged
        elif not one["trusted"]:
            found[one["name"]] = replace(judged, interval=None)
    powers = {base: (found[base], getattr(traits, base)) for base in ("volume_mm3", "total_length_mm", "tips", "mean_diameter_mm")}
    for name, factors in _DERIVED.items():
        found[name] = _derive(getattr(traits, name), *((*powers[base], power) for base, power in factors.items()))
    found["length_by_order_mm"] = _moved_length(summary, traits, found["total_length_mm"])
    depth, hidden_mm = found["depth_mm"], summary.get("hidden_height_mm")
    if depth.interval is not None:
        low, high = depth.interval
        found["depth_mm"] = NO_INTERVAL if hidden_mm is None else replace(depth, interval=(low, high + hidden_mm))
    return found


def _moved_length(summary: Json, traits: Traits, length: Assessment) -> Assessment:
    """Return the assessment of the length that may belong to another order, because forks are ambiguous."""
    share = next((check["value"] for check in summary.get("checks") or () if check["name"] == "forks"), None)
    if share is None or traits.total_length_mm is None:
        return replace(length, interval=None)
    return replace(length, interval=(-share * traits.total_length_mm, share * traits.total_length_mm))


def _judge(trusted: bool, interval: Pair, reason: str, codes: tuple[str, ...]) -> Assessment:
    return Assessment(
        verdict="reliable" if trusted else "not reliable",
        interval=(float(interval[0]), float(interval[1])),
        reason="" if trusted else reason,
        codes=() if trusted else codes,
    )


def _derive(derived: float | int | None, *factors: tuple[Assessment, float | None, int]) -> Assessment:
    """Return the assessment of a trait that is proportional to powers of other traits.

    Parameters
    ----------
    derived : float, int or None
        Value of the trait. The limits of a count are whole numbers.
    *factors : tuple
        Assessment, value and power of each of the other traits. Their relative uncertainties add up in quadrature.
    """
    refused = [base for base, _, _ in factors if base.verdict == "not reliable"]
    verdict = refused[0] if refused else Assessment(verdict="reliable")
    reach = np.zeros(2)
    for base, value, power in factors:
        if not value or derived is None or base.interval is None or not base.interval[0] > 0.0:
            return replace(verdict, interval=None) if refused else NO_INTERVAL
        reach = np.hypot(reach, np.sort(power * np.log(np.divide(base.interval, value))))
    low, high = (derived * np.exp([-1.0, 1.0] * reach)).tolist()
    if isinstance(derived, int):
        low, high = math.floor(low), math.ceil(high)
    return replace(verdict, interval=(low, high))
