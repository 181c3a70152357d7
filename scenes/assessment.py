"""Reliability of a trait: 90 % interval and verdict."""

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

Verdict = Literal["reliable", "not reliable", "not assessed"]


@dataclass(frozen=True, kw_only=True)
class Assessment:
    """Reliability of one trait in one result."""

    verdict: Verdict = "not assessed"
    """Verdict on the trait. ``not assessed`` means that the method does not estimate an uncertainty of the trait."""
    interval: tuple[float, float] | None = None
    """90 % interval in the unit of the trait; None if the trait is not assessed."""
    reason: str = ""
    """Reason why the trait is not reliable, as a sentence; otherwise empty."""
    codes: tuple[str, ...] = ()
    """Codes of the reasons (`recon.results.reasons`) for other programs; empty if the trait is reliable or not
    assessed."""


NOT_ASSESSED = Assessment()
MOST_REASONS = 3
"""Maximum number of reasons listed in a sentence. The individual results state all of their reasons."""


def left_out(trait: str, reasons: Iterable[str], *, total: int) -> str:
    """Return a sentence about the excluded values of a trait; empty if no value is excluded.

    Parameters
    ----------
    trait : str
        Name of the trait.
    reasons : iterable of str
        Reason for the exclusion of each excluded value. The sentence lists the most frequent reasons.
    total : int
        Total number of values, including the excluded values.
    """
    counted = Counter(reasons)
    if not counted:
        return ""
    named = "; ".join(f"{reason} ({count})" if count > 1 else reason for reason, count in counted.most_common(MOST_REASONS))
    more = "; and other reasons" if len(counted) > MOST_REASONS else ""
    return f"{trait}: {sum(counted.values())} of {total} values are excluded, because they are not reliable: {named}{more}"
