"""Reason codes of results that are not reliable, and short sentences in tables."""

from typing import Any

import pytest

from rhizotwin.recon.results import reasons
from rhizotwin.recon.results.parts import Json

TERM = {"name": "views disagree", "less_mm3": 300.0, "more_mm3": 10.0, "why": "views disagree"}


def summary(**changes: Any) -> Json:
    """Return what the codes are derived from, of a volume that is refused for no known reason."""
    found = {
        "volume_trusted": False,
        "volume_budget": [TERM | {"less_mm3": 50.0}, TERM | {"name": "scale", "less_mm3": 20.0}],
        "volume_mm3": 1000.0,
        "volume_interval_mm3": [950.0, 1050.0],
        "checks": [],
        "settings": {},
        "views": [{"used": True}] * 12,
    }
    return found | changes


@pytest.mark.parametrize(
    ("changes", "codes"),
    [
        ({"volume_trusted": True}, ()),
        ({"volume_budget": []}, ("no_uncertainty",)),
        ({"checks": [{"name": "resolution", "state": "bad"}, {"name": "motion", "state": "fair"}]}, ("coarse_pictures",)),
        ({"views": [{"used": True}] * 7 + [{"used": False}]}, ("few_views",)),
        ({"volume_interval_mm3": [700.0, 1010.0], "volume_budget": [TERM]}, ("wide_interval", "high_views_disagree")),
        ({"volume_interval_mm3": [700.0, 1010.0], "volume_budget": [TERM], "settings": {"trust": {"widest": 0.4}}}, ("other",)),
        ({"volume_interval_mm3": [700.0, 1010.0], "volume_budget": [{"less_mm3": 300.0, "more_mm3": 10.0}]}, ("wide_interval",)),
        ({}, ("other",)),
    ],
    ids=["trusted", "baseline", "check", "views", "interval", "wider limit", "term without a name", "unknown"],
)
def test_codes_of_a_volume(changes: dict[str, Any], codes: tuple[str, ...]) -> None:
    assert reasons.reasons_for_volume(summary(**changes)) == codes


def test_codes_of_an_estimate() -> None:
    own = {"trusted": False, "value": 100.0, "interval": [60.0, 110.0]}
    assert reasons.reasons_for_estimate(summary(volume_trusted=True), own) == ("wide_interval",)
    assert reasons.reasons_for_estimate(summary(volume_budget=[]), own | {"interval": [90.0, 110.0]}) == ("no_uncertainty",)
    assert reasons.reasons_for_estimate(summary(volume_trusted=True), own | {"interval": [90.0, 110.0]}) == ("thin_roots",)
    assert reasons.reasons_for_estimate(summary(), own | {"trusted": True}) == ()


def test_every_check_has_a_code() -> None:
    from typing import get_args

    from rhizotwin.recon.uncertainty.checks import Name

    assert set(reasons.OF_CHECK) == set(get_args(Name))


def test_cells_are_short() -> None:
    assert reasons.shorten(["a", "b"]) == "a; b"
    assert reasons.shorten(["word " * 100]).endswith("word ...")
    several = reasons.shorten(["word " * 40] * 3)
    assert several.endswith("and 2 more in result.json")
    assert len(several) < 300
