"""Assessment of the reliability of a trait: 90 % interval and verdict."""

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Literal

Verdict = Literal["reliable", "not reliable", "no interval"]


@dataclass(frozen=True, kw_only=True)
class Assessment:
    """Reliability of one trait in one result."""

    verdict: Verdict = "no interval"
    """Verdict on the trait. ``no interval`` means that the uncertainty of the trait is not estimated."""
    interval: tuple[float, float] | None = None
    """90 % interval in the unit of the trait. It is None if it is not estimated."""
    reason: str = ""
    """Reason why the trait is not reliable or has no interval, as a sentence. It is empty if the trait is reliable."""
    codes: tuple[str, ...] = ()
    """Codes of the reasons (`recon.results.reasons`), for use by other programs. There are none if the trait is
    reliable or has no interval."""


NO_INTERVAL = Assessment(reason="the uncertainty is not estimated; measured on the reconstructed shape and centre lines")
MOST_NAMED = 4
"""Maximum number of traits that the reason for a verdict names. More traits are those of the whole result."""
MOST_REASONS = 3
"""Maximum number of reasons in a sentence about several results. All reasons are stated in the individual results."""


def reasons(assessed: Mapping[str, Assessment]) -> list[str]:
    """Return a sentence for each reason why traits are not reliable or have no interval.

    Parameters
    ----------
    assessed : mapping of str to Assessment
        Assessments of traits, keyed by name for display.
    """
    named: dict[tuple[str, str], list[str]] = {}
    for name, one in assessed.items():
        if one.reason:
            named.setdefault((one.verdict, one.reason), []).append(name)
    whose = {key: f" ({', '.join(names)})" if len(names) <= MOST_NAMED else "" for key, names in named.items()}
    return [f"{verdict}{whose[verdict, reason]}: {reason}" for verdict, reason in named]


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
