"""Checks that a scan must pass for its volume to be trusted.

Each check compares one measured number with limits derived from its effect on a volume. It states the finding and the
advice in one sentence each. A check in the state "bad" makes the volume not trusted; "fair" is only reported.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

NO_VOLUME = "this scan cannot give a volume: "
"""Prefix of every such verdict."""

State = Literal["good", "fair", "bad", "unknown"]
Name = Literal[
    "scan", "exposure", "curve", "sharpness", "markers", "canister", "motion", "dirt", "views", "sight", "resolution", "corrections"
]
Limits = tuple[float, float]
"""Limits above which a number is fair, and bad; below which, if the first is larger."""


@dataclass(frozen=True, kw_only=True)
class Estimate:
    """A number of the roots with its uncertainty."""

    name: str
    """Name of the trait: total_length_mm, tips or mean_diameter_mm."""
    value: float
    interval: tuple[float, float]
    """90 % interval."""
    trusted: bool
    verdict: str
    """Reliability of the number, in one sentence."""


@dataclass(frozen=True, kw_only=True)
class Check:
    """Result of one check."""

    name: Name
    state: State
    """``bad``: the volume is not trusted; ``unknown``: the pictures do not show it."""
    value: float | None
    """Measured value; None if it could not be measured."""
    unit: str
    fair: float | None
    """Limit above which the state is fair (below which, for numbers that should be large)."""
    bad: float | None
    """Limit above which it is bad."""
    found: str
    """Finding with its amount, in one sentence."""
    advice: str
    """Advice, in one sentence; empty if the state is good."""


def failure_reasons(checks: Sequence[Check]) -> tuple[str, ...]:
    """Return a sentence for each check in the state "bad"."""
    return tuple(f"{check.found} ({check.advice})" if check.advice else check.found for check in checks if check.state == "bad")


def name_cause(checks: Sequence[Check]) -> tuple[Check, ...]:
    """Return checks with low resolution named as the cause of its consequences.

    If roots are too thin in the pictures, views disagree, and static roots appear to move.
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
    """Return the verdict of a scan without a trusted volume, from the reasons."""
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
    """Return a check of a number against its limits; advice is omitted if the state is good.

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


def first_problem(*made: Check) -> Check:
    """Return the first check that is not good, or else the last."""
    return next((check for check in made if check.state != "good"), made[-1])


def make_unknown(name: Name, found: str, advice: str = "", *, unit: str = "", limits: Limits | None = None) -> Check:
    """Return a check of a quantity that the pictures do not show.

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
    """Classify a number that should be small by its limits; if ``fair`` is above ``bad``, one that should be large."""
    if fair > bad:
        value, fair, bad = -value, -fair, -bad
    return "bad" if value > bad else "fair" if value > fair else "good"
