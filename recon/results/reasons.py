"""Reason codes: short, stable names for the reasons why a result is not reliable, for programs that read tables.

The codes are derived from the numbers in ``result.json``, and not from its sentences, so that they do not depend on
wording.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

from rhizotwin.recon.results.parts import Json
from rhizotwin.recon.settings import TrustSettings

OF_CHECK = {
    "scan": "incomplete_scan",
    "exposure": "wrong_exposure",
    "curve": "wrong_response_curve",
    "sharpness": "blurred_pictures",
    "markers": "poor_markers",
    "canister": "canister_mismatch",
    "motion": "moving_roots",
    "dirt": "dirty_canister",
    "views": "unusable_views",
    "sight": "inconsistent_views",
    "resolution": "coarse_pictures",
    "corrections": "contradicted_corrections",
}
"""Reason code for each check of a scan, used if the state of the check is ``bad``."""
NO_UNCERTAINTY = "no_uncertainty"
"""Reason code: the reconstruction method does not estimate an uncertainty. This applies to the baseline methods."""
FEW_VIEWS = "few_views"
"""Reason code: the number of used views is less than the setting ``trust.least_views``."""
WIDE = "wide_interval"
"""Reason code: a limit of the 90 % interval differs from the value by more than the setting ``trust.widest`` allows.
For traits other than the volume, the default of this setting applies."""
OTHER = "other"
"""Reason code: none of the other codes applies. The reason is described by the sentence in ``result.json``."""
MAX_SENTENCE = 280
"""Maximum length of the sentences in a table cell, in characters."""


def reasons_for_volume(summary: Json) -> tuple[str, ...]:
    """Return the codes of the reasons why the volume is not reliable, or an empty tuple if it is reliable.

    The code for a wide interval is followed by the code of its largest error term, such as ``high_translucency`` or
    ``high_missing_roots``.

    Parameters
    ----------
    summary : Json
        Contents of ``result.json``.
    """
    if summary["volume_trusted"]:
        return ()
    terms = summary["volume_budget"]
    if not terms:
        return (NO_UNCERTAINTY,)
    codes = [OF_CHECK[check["name"]] for check in summary.get("checks") or () if check["state"] == "bad" and check["name"] in OF_CHECK]
    trust = _trust(summary)
    if sum(bool(view["used"]) for view in summary["views"]) < trust.get("least_views", TrustSettings.least_views):
        codes.append(FEW_VIEWS)
    volume, (low, high) = float(summary["volume_mm3"]), summary["volume_interval_mm3"]
    most = trust.get("widest", TrustSettings.widest) * volume
    under, over = volume - low > most, high - volume > most
    if under or over:
        worst = max(terms, key=lambda term: max(under * term["less_mm3"], over * term["more_mm3"]))
        name = re.sub(r"[^a-z0-9]+", "_", str(worst.get("name", "")).lower()).strip("_")  # terms of earlier versions have none
        codes += [WIDE, f"high_{name}"] if name else [WIDE]
    return tuple(dict.fromkeys(codes)) or (OTHER,)


def is_wide(summary: Json, value: float, interval: Sequence[float]) -> bool:
    """Return whether a limit of an interval differs from the value by more than the setting ``trust.widest`` allows."""
    most = _trust(summary).get("widest", TrustSettings.widest) * value
    return max(value - interval[0], interval[1] - value) > most


def _trust(summary: Json) -> Json:
    return summary.get("settings", {}).get("trust") or {}


def reasons_for_estimate(summary: Json, estimate: Json) -> tuple[str, ...]:
    """Return the codes of the reasons why a length, number of tips or mean diameter is not reliable.

    The tuple is empty if the value is reliable.

    Parameters
    ----------
    summary, estimate : Json
        Contents of ``result.json``, and one of its ``estimates``.
    """
    if estimate["trusted"]:
        return ()
    value, (low, high) = float(estimate["value"]), estimate["interval"]
    widest = TrustSettings.widest * value
    codes = [*reasons_for_volume(summary), *([WIDE] if max(value - low, high - value) > widest else [])]
    return tuple(dict.fromkeys(codes)) or ("thin_roots",)


def shorten(sentences: Sequence[str], *, most: int = MAX_SENTENCE) -> str:
    """Join sentences for a table cell. Sentences beyond the maximum length are replaced by their number.

    Parameters
    ----------
    sentences : sequence of str
        Sentences to be joined. Their full text is in ``result.json``.
    most : int
        Maximum length of the text, in characters.
    """
    kept: list[str] = []
    for sentence in sentences:
        text = sentence if len(sentence) <= most else f"{sentence[:most].rsplit(' ', 1)[0]} ..."
        if len("; ".join([*kept, text])) > most + len(" ..."):
            break
        kept.append(text)
    left = len(sentences) - len(kept)
    return "; ".join([*kept, *([f"and {left} more in result.json"] if left else [])])
