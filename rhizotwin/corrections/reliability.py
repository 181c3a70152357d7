"""Reliability of a corrected result: error budget, checks and verdict of its volume, and unreliable traits."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

from rhizotwin.corrections import against_pictures
from rhizotwin.corrections.session import Session
from rhizotwin.recon.results.parts import Json
from rhizotwin.recon.uncertainty.budget import Budget, Term
from rhizotwin.recon.uncertainty.calibration import Calibration
from rhizotwin.recon.uncertainty.checks import NO_VOLUME, Check, failure_reasons, verdict
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.traits import Traits


def judge_volume(session: Session, summary: Json, dataset: Path | None) -> Json:
    """Return the interval, error budget, verdict and checks of a corrected volume as entries of ``result.json``.

    If the result was already a corrected one, a single term and a single check cover all its corrections.

    Parameters
    ----------
    session : Session
        Result and its corrections.
    summary : Json
        Content of ``result.json`` for the corrected result, of which the volume and the entry ``edits`` are used.
    dataset : path or None
        Folder of the dataset. None: the dataset recorded in the result. If the dataset is missing, the volume is not
        reliable.
    """
    old = session.summary
    before_mm3 = float(session.summary["volume_mm3"])
    after_mm3 = float(summary["volume_mm3"])
    ratio = after_mm3 / before_mm3 if before_mm3 > 0.0 else 1.0
    terms = [
        Term(name=str(t.get("name", "")), less_mm3=ratio * t["less_mm3"], more_mm3=ratio * t["more_mm3"], why=t["why"])
        for t in old["volume_budget"]
    ]
    checks = list(old.get("checks") or [])
    lost = [] if old["volume_trusted"] else str(old["volume_verdict"]).removeprefix(NO_VOLUME).split("; ")
    if session.log.edits:
        try:
            found = against_pictures.recorded(old) + against_pictures.compare(session, dataset)
        except UserError as error:
            lost.append(f"the corrections were not compared with the pictures: {error}")
        else:
            check = found.check()
            term = found.term(float(summary["edits"]["volume_before_mm3"]), after_mm3)
            earlier = failure_reasons([Check(**one) for one in checks if one["name"] == check.name])
            terms = [*(one for one in terms if one.name != term.name), term]
            checks = [*(one for one in checks if one["name"] != check.name), asdict(check)]
            lost = [*(reason for reason in lost if reason not in earlier), *failure_reasons([check])]
    budget = Budget(
        volume_mm3=after_mm3,
        terms=tuple(terms),
        views=sum(view["used"] for view in old["views"]),
        calibration=Calibration.from_plain(old.get("calibration")),
    )
    if old["volume_trusted"]:
        lost += budget.objections
    verdict_now = f"{budget.verdict}, provided that the corrections are right" if session.log.edits else budget.verdict
    return {
        "volume_interval_mm3": list(budget.interval_mm3),
        "volume_budget": [asdict(term) for term in terms],
        "volume_trusted": not lost,
        "volume_verdict": verdict(lost) if lost else verdict_now,
        "checks": checks,
    }


def unreliable_estimates(old: Json, traits: Traits) -> list[Json]:
    """Return the estimates of a result that are not reliable, with their corrected values.

    A trait that was not reliable is not reliable after corrections either. Its interval is extended to the corrected
    value. Reliable estimates are omitted, because their intervals are only valid for the uncorrected roots.

    Parameters
    ----------
    old : Json
        Content of ``result.json`` before the corrections.
    traits : Traits
        Traits after the corrections.
    """
    found = []
    for one in old.get("estimates") or ():
        value = getattr(traits, one["name"], None)
        if not one["trusted"] and value is not None:
            low, high = one["interval"]
            found.append({**one, "value": float(value), "interval": [min(low, float(value)), max(high, float(value))]})
    return found
