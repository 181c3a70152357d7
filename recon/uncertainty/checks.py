"""Checks that a scan must pass for its volume to be trusted.

Each check compares a measured value with limits. The limits are derived from the effect of this value on the volume.
The check states its finding and its advice in one sentence each. If its state is "bad", the volume is not trusted. The
state "fair" is only reported.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

NO_VOLUME = "this scan cannot give a volume: "
"""Beginning of the verdict on a scan whose volume is not trusted."""

State = Literal["good", "fair", "bad", "unknown"]
Name = Literal[
    "scan",
    "exposure",
    "curve",
    "sharpness",
    "markers",
    "canister",
    "motion",
    "dirt",
    "views",
    "sight",
    "resolution",
    "forks",
    "corrections",
]
Limits = tuple[float, float]
"""Limits for the states fair and bad, in this order. A value above a limit is in the corresponding state. If the first
limit is larger than the second, values below a limit are."""


@dataclass(frozen=True, kw_only=True)
class Estimate:
    """Estimate of a trait of the roots, with its uncertainty."""

    name: str
    """Field of the trait: total_length_mm, tips or mean_diameter_mm."""
    value: float
    interval: tuple[float, float]
    """Lower and upper limit of the 90 % interval."""
    trusted: bool
    verdict: str
    """Reliability of the estimate, in one sentence."""


@dataclass(frozen=True, kw_only=True)
class Check:
    """Result of one check."""

    name: Name
    state: State
    """State of the check. If it is ``bad``, the volume is not trusted. It is ``unknown`` if the pictures do not show
    what the check is about."""
    value: float | None
    """Measured value. It is None if the value could not be measured."""
    unit: str
    fair: float | None
    """Limit for the state "fair". The value is above the limit in this state, or below it if values should be large."""
    bad: float | None
    """Limit for the state "bad", in the same sense as ``fair``."""
    found: str
    """Result of the check with the measured value, in one sentence."""
    advice: str
    """Advice to the user, in one sentence. It is empty if the state is good."""


def failure_reasons(checks: Sequence[Check]) -> tuple[str, ...]:
    """Return a sentence for each check in the state "bad"."""
    return tuple(f"{check.found} ({check.advice})" if check.advice else check.found for check in checks if check.state == "bad")


def name_cause(checks: Sequence[Check]) -> tuple[Check, ...]:
    """Return the checks, with low resolution stated as the cause of other failures.

    If roots are too thin in the pictures, views disagree, and roots at rest appear to move.
    """
    thin = next((check for check in checks if check.name == "resolution" and check.state in ("fair", "bad")), None)
    if thin is None:
        return tuple(checks)
    return tuple(
        replace(check, found=f"{thin.found}, so that {check.found}", advice=thin.advice)
        if check.name in ("motion", "sight") and check.state == "bad"
        else check
        for check in checks
    )


def verdict(lost: Sequence[str]) -> str:
    """Return the verdict on a scan whose volume is not trusted, given the reasons."""
    return NO_VOLUME + "; ".join(lost)


def make_check(name: Name, state: State, value: float | None, unit: str, limits: Limits | None, found: str, advice: str = "") -> Check:
    """Return a check with a given state.

    Parameters
    ----------
    name, state : Name, State
        Name and state of the check.
    value, unit : (float or None), str
        Measured value, None if not measured, and its unit.
    limits : Limits or None
        Limits for fair and bad.
    found : str
        Finding with its amount, in one sentence.
    advice : str
        Advice, in one sentence.

    Returns
    -------
    Check
        The check.
    """
    fair, bad = (None, None) if limits is None else limits
    return Check(name=name, state=state, value=value, unit=unit, fair=fair, bad=bad, found=found, advice=advice)


def judge(name: Name, value: float, unit: str, limits: Limits, found: str, advice: str) -> Check:
    """Return a check that compares a value with its limits.

    The advice is omitted if the state is good.

    Parameters
    ----------
    name : Name
        Name of the check.
    value, unit : float, str
        Measured value and its unit.
    limits : Limits
        Limits for fair and bad.
    found : str
        Finding with its amount, in one sentence.
    advice : str
        Advice, in one sentence.

    Returns
    -------
    Check
        In the state good, fair or bad.
    """
    state = classify(value, *limits)
    return make_check(name, state, value, unit, limits, found, "" if state == "good" else advice)


def worst(*made: Check) -> Check:
    """Return the check with the worst state: the first bad one, else the first fair one, else the first unknown one.

    If all are good, the last check is returned.
    """
    return next((check for state in ("bad", "fair", "unknown") for check in made if check.state == state), made[-1])


def make_unknown(name: Name, found: str, advice: str = "", *, unit: str = "", limits: Limits | None = None) -> Check:
    """Return a check in the state "unknown", for a quantity that the pictures do not show.

    Parameters
    ----------
    name : Name
        Name of the check.
    found : str
        Reason, in one sentence.
    advice : str
        Advice, in one sentence.
    unit, limits : str, (Limits or None)
        Unit and limits of the quantity.

    Returns
    -------
    Check
        In the state ``unknown``.
    """
    return make_check(name, "unknown", None, unit, limits, found, advice)


def classify(value: float, fair: float, bad: float) -> State:
    """Classify a value as good, fair or bad.

    The value should be small. If ``fair`` is larger than ``bad``, it should be large. A value that is not a number is
    bad.
    """
    if fair > bad:
        value, fair, bad = -value, -fair, -bad
    return "good" if value <= fair else "fair" if value <= bad else "bad"
