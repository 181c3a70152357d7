"""What a scan must pass before its volume is trusted.

Checks of the pictures themselves, that do not lean on what was made of them.

Each check compares one measured number with limits that come from what it would do to a volume, and says in one
sentence what was found, and in another what to do about it. One that fails takes the trust away; one that is only so-so
is said.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

NO_VOLUME = "this scan cannot give a volume: "
"""How every such verdict begins."""

State = Literal["good", "fair", "bad", "untold"]
Name = Literal[
    "scan", "exposure", "curve", "sharpness", "markers", "canister", "motion", "dirt", "views", "sight", "resolution", "corrections"
]
Limits = tuple[float, float]
"""Beyond which a number is fair, and bad; where the first is larger, below which."""


@dataclass(frozen=True, kw_only=True)
class Estimate:
    """One number of the roots with what is known of its error."""

    name: str
    """Of the trait: total_length_mm, tips or mean_diameter_mm."""
    value: float
    interval: tuple[float, float]
    """90 % interval."""
    trusted: bool
    verdict: str
    """One sentence: what the number is worth."""


@dataclass(frozen=True, kw_only=True)
class Check:
    """One light of the traffic light."""

    name: Name
    state: State
    """``bad``: the volume is not to be trusted; ``untold``: the pictures do not show it."""
    value: float | None
    """What was measured; None where nothing was."""
    unit: str
    fair: float | None
    """Beyond this the state is fair (below it for numbers that should be large)."""
    bad: float | None
    """Beyond this it is bad."""
    found: str
    """What was found, by how much: one sentence."""
    advice: str
    """What to do: one sentence; empty where all is well."""


def failed(checks: Sequence[Check]) -> tuple[str, ...]:
    """Return a sentence for each check that takes the trust away."""
    return tuple(f"{check.found} ({check.advice})" if check.advice else check.found for check in checks if check.state == "bad")


def explained(checks: Sequence[Check]) -> tuple[Check, ...]:
    """Return checks in which coarse pictures are named as the cause of what follows from them.

    Where roots are too thin in the pictures, views disagree and roots seem to move though nothing moved.
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
    """Say that a scan gives no volume, and why."""
    return NO_VOLUME + "; ".join(lost)


def stated(name: Name, state: State, value: float | None, unit: str, limits: Limits | None, found: str, advice: str = "") -> Check:
    """Return a check whose state is known.

    Parameters
    ----------
    name, state : Name, State
        Of the check.
    value, unit : (float or None), str
        What was measured; None where nothing was.
    limits : Limits or None
        Fair and bad.
    found : str
        What was found, by how much: one sentence.
    advice : str
        What to do: one sentence.

    Returns
    -------
    Check
        As given.
    """
    fair, bad = (None, None) if limits is None else limits
    return Check(name=name, state=state, value=value, unit=unit, fair=fair, bad=bad, found=found, advice=advice)


def judged(name: Name, value: float, unit: str, limits: Limits, found: str, advice: str) -> Check:
    """Return a check of a number against its limits; a good one needs no advice.

    Parameters
    ----------
    name : Name
        Of the check.
    value, unit : float, str
        What was measured.
    limits : Limits
        Fair and bad.
    found : str
        What was found, by how much: one sentence.
    advice : str
        What to do: one sentence.

    Returns
    -------
    Check
        Good, fair or bad.
    """
    state = state_of(value, *limits)
    return stated(name, state, value, unit, limits, found, "" if state == "good" else advice)


def foremost(*made: Check) -> Check:
    """Return the first check that is not good, or else the last."""
    return next((check for check in made if check.state != "good"), made[-1])


def untold(name: Name, found: str, advice: str = "", *, unit: str = "", limits: Limits | None = None) -> Check:
    """Return a check of what the pictures do not show.

    Parameters
    ----------
    name : Name
        Of the check.
    found : str
        Why they do not: one sentence.
    advice : str
        What to do: one sentence.
    unit, limits : str, (Limits or None)
        Of what would have been measured.

    Returns
    -------
    Check
        With the state ``untold``.
    """
    return stated(name, "untold", None, unit, limits, found, advice)


def state_of(value: float, fair: float, bad: float) -> State:
    """Compare a number that should be small with its limits; with ``fair`` above ``bad``, one that should be large."""
    if fair > bad:
        value, fair, bad = -value, -fair, -bad
    return "bad" if value > bad else "fair" if value > fair else "good"
