"""Assessment of the reliability of a trait: 90 % interval and verdict."""

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
    """90 % interval in the unit of the trait. It is None if the trait is not assessed."""
    reason: str = ""
    """Reason why the trait is not reliable, as a sentence. It is empty if the trait is reliable or not assessed."""
    codes: tuple[str, ...] = ()
    """Codes of the reasons (`recon.results.reasons`), for use by other programs. There are none if the trait is
    reliable or not assessed."""


NOT_ASSESSED = Assessment()
MOST_REASONS = 3
"""Maximum number of reasons in a sentence about several results. All reasons are stated in the individual results."""


def left_out(trait: str, reasons: Iterable[str], *, total: int) -> str:
    """Return a sentence about the values of a trait that were excluded. It is empty if no value was excluded.

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
