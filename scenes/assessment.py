"""Reliability of a trait: its 90 % interval and a verdict."""

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

Verdict = Literal["reliable", "not reliable", "not assessed"]


@dataclass(frozen=True, kw_only=True)
class Assessment:
    """Reliability of one trait of one result."""

    verdict: Verdict = "not assessed"
    """``not assessed``: the method gives no uncertainty of this trait."""
    interval: tuple[float, float] | None = None
    """90 % interval in the unit of the trait; None if it is not assessed."""
    reason: str = ""
    """Reason why the trait is not reliable, as a sentence; empty otherwise."""
    codes: tuple[str, ...] = ()
    """Codes of the reasons (`recon.results.reasons`), for programs; empty if the trait is reliable or not assessed."""


NOT_ASSESSED = Assessment()
MOST_REASONS = 3
"""Maximum number of reasons in a sentence; each result states its own."""


def left_out(trait: str, reasons: Iterable[str], *, total: int) -> str:
    """Return a sentence on the excluded values of a trait; empty if there are none.

    Parameters
    ----------
    trait : str
        Name of the trait.
    reasons : iterable of str
        Reason of each excluded value; the most frequent ones are listed.
    total : int
        Number of values, including the excluded ones.
    """
    counted = Counter(reasons)
    if not counted:
        return ""
    named = "; ".join(f"{reason} ({count})" if count > 1 else reason for reason, count in counted.most_common(MOST_REASONS))
    more = "; and others" if len(counted) > MOST_REASONS else ""
    return f"{trait}: {sum(counted.values())} of {total} values are excluded, because they are not reliable: {named}{more}"
