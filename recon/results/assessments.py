"""Reliability of every trait of a result, from the intervals and verdicts in ``result.json``."""

from __future__ import annotations

from dataclasses import replace

from rhizotwin.recon.results import reasons
from rhizotwin.recon.results.parts import Json
from rhizotwin.recon.uncertainty.checks import NO_VOLUME
from rhizotwin.scenes.assessment import NO_INTERVAL, Assessment
from rhizotwin.scenes.trait_table import DEFINITIONS
from rhizotwin.scenes.traits import Traits

Pair = tuple[float, float]


_PART_IS_WIDE = "the 90 % interval is too wide for a plant of this size, since it includes the uncertainty of all plants in the canister"


def assess(summary: Json, traits: Traits, *, volume_interval_mm3: Pair | None = None) -> dict[str, Assessment]:
    """Return the assessment of each trait, keyed by its field in `Traits`.

    Volume, length, tips and mean diameter have their own intervals. The intervals of specific root length and tissue
    density are derived from those of length and volume. All other traits have no interval. They are not reliable if the
    volume is not reliable. If a length, number of tips or mean diameter of the whole scan is not reliable, that of each
    of its plants is not reliable either.

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
    found["specific_root_length_m_per_g"] = _derive(
        found["total_length_mm"], traits.total_length_mm, traits.specific_root_length_m_per_g, 1
    )
    found["tissue_density_g_per_ml"] = _derive(found["volume_mm3"], traits.volume_mm3, traits.tissue_density_g_per_ml, -1)
    return found


def _judge(trusted: bool, interval: Pair, reason: str, codes: tuple[str, ...]) -> Assessment:
    return Assessment(
        verdict="reliable" if trusted else "not reliable",
        interval=(float(interval[0]), float(interval[1])),
        reason="" if trusted else reason,
        codes=() if trusted else codes,
    )


def _derive(base: Assessment, value: float | None, derived: float | None, power: int) -> Assessment:
    """Return the assessment of a trait that is proportional to a power of another trait."""
    if value is None or derived is None or base.interval is None or not base.interval[0] > 0.0:
        return replace(base, interval=None) if base.verdict == "not reliable" else NO_INTERVAL
    low, high = sorted(derived * (end / value) ** power for end in base.interval)
    return replace(base, interval=(low, high))
