"""Reliability of a trait: its 90 % interval and a verdict."""

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

Verdict = Literal["reliable", "not reliable", "not assessed"]


@dataclass(frozen=True, kw_only=True)
class Assessment:
    """The reliability of one trait of one result."""

    verdict: Verdict = "not assessed"
    """``not assessed``: no uncertainty is computed for this trait."""
    interval: tuple[float, float] | None = None
    """90 % interval in the unit of the trait; None if it is not assessed."""
    reason: str = ""
    """Reason why the trait is not reliable; empty otherwise."""


NOT_ASSESSED = Assessment()
MOST_REASONS = 3
"""Maximum number of reasons in a sentence; each result contains its own in full."""


def left_out(trait: str, reasons: Iterable[str], *, total: int) -> str:
    """Return a sentence about the values of a trait that were left out as not reliable; empty if there are none.

    Parameters
    ----------
    trait : str
        Name of the trait.
    reasons : iterable of str
        Reason for each value that was left out; the most frequent ones are listed.
    total : int
        Number of all values, including those that were left out.
    """
    counted = Counter(reasons)
    if not counted:
        return ""
    named = "; ".join(f"{reason} ({count})" if count > 1 else reason for reason, count in counted.most_common(MOST_REASONS))
    more = "; and others" if len(counted) > MOST_REASONS else ""
    return f"{trait}: {sum(counted.values())} of {total} values are left out, because they are not reliable: {named}{more}"
