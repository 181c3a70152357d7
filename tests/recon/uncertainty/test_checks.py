"""Checks of trust: what passes, what is said, and what takes the trust away."""

import numpy as np
import pytest

from rhizotwin.recon.calibration.exposure import Exposures
from rhizotwin.recon.pictures import CurveFound
from rhizotwin.recon.uncertainty import checks, picture_checks, shape_checks
from rhizotwin.recon.uncertainty.budget import Budget, Term
from rhizotwin.scenes import transfer
from rhizotwin.scenes.dataset import Frame
from rhizotwin.scenes.model import Scene, Tank
from rhizotwin.scenes.transfer import LINEAR, SRGB

FRAMES = [Frame(file=f"images/{k}.png", sha256="") for k in range(3)]


@pytest.mark.parametrize(
    ("value", "fair", "bad", "expected"),
    [(1.0, 1.0, 2.0, "good"), (1.1, 1.0, 2.0, "fair"), (2.1, 1.0, 2.0, "bad"), (0.1, 0.2, 0.05, "fair"), (0.01, 0.2, 0.05, "bad")],
)
def test_a_number_is_judged_by_its_limits(value: float, fair: float, bad: float, expected: str) -> None:
    assert checks.state_of(value, fair, bad) == expected


@pytest.mark.parametrize(
    ("origin", "expected", "says"),
    [
        ({"complete": True, "planned_views": 3}, "good", "all of its 3"),
        ({"complete": False, "planned_views": 40}, "bad", "stopped after 3 of 40"),
        ({"complete": True, "settings": {"twin": {"fidelity": "sketch"}}}, "bad", "sketches"),
        ({"program": "rhizotwin import"}, "good", "3 pictures"),
    ],
    ids=["finished", "stopped", "sketch", "imported"],
)
def test_a_scan_is_finished_and_no_sketch(origin: dict[str, object], expected: str, says: str) -> None:
    found = picture_checks.of_scan(origin, FRAMES)
    assert found.state == expected
    assert says in found.found
    assert bool(found.advice) == (expected == "bad")


@pytest.mark.parametrize(
    ("used", "stated", "bend", "expected"),
    [
        (LINEAR, LINEAR, 0.001, "good"),
        (SRGB, LINEAR, 0.001, "fair"),
        (transfer.power(1.5), LINEAR, 0.001, "bad"),
        (LINEAR, LINEAR, 0.18, "bad"),
        (LINEAR, LINEAR, None, "untold"),
    ],
    ids=["as stated", "corrected", "unknown gamma", "wrong", "no markers"],
)
def test_a_curve_is_trusted_where_edges_bear_out_a_known_one(
    used: transfer.Curve, stated: transfer.Curve, bend: float | None, expected: str
) -> None:
    found = picture_checks.of_curve(CurveFound(curve=used, stated=stated, bend=bend, stated_bend=bend, markers=30))
    assert found.state == expected


def exposures(*, gain: list[float], clipped: float = 0.0, level: float = 0.7, uneven: float = 0.0) -> Exposures:
    count = len(gain)
    full = {"clipped": np.full(count, clipped), "level": np.full(count, level), "uneven": np.full(count, uneven)}
    return Exposures(gain=np.array(gain), told=True, **full)


@pytest.mark.parametrize(
    ("found", "expected", "says"),
    [
        (exposures(gain=[1.0, 1.01]), "good", "wanders by 0.5 %"),
        (exposures(gain=[0.9, 1.1]), "fair", "10 %"),
        (exposures(gain=[1.0, 1.0], clipped=0.1), "bad", "10 % of the panel are at full scale"),
        (exposures(gain=[1.0, 1.0], level=0.02), "bad", "only 2 %"),
        (exposures(gain=[1.0, 1.0], uneven=0.07), "bad", "from place to place"),
        (None, "untold", "no bare panel"),
    ],
)
def test_exposure_is_even_bright_and_not_clipped(found: Exposures | None, expected: str, says: str) -> None:
    made = picture_checks.of_exposure(found)
    assert made.state == expected
    assert says in made.found


def test_views_go_round() -> None:
    assert picture_checks.of_views(list(range(0, 360, 9)), 40).state == "good"
    assert picture_checks.of_views(list(range(0, 180, 9)), 20).state == "bad"
    assert picture_checks.of_views(list(range(0, 360, 18)), 40).state == "bad"  # a half was left out


def test_the_worst_of_what_is_seen_is_told() -> None:
    good = shape_checks.of_sight(missed=0.01, unexplained=0.0, fill=0.1)
    assert (good.state, good.advice) == ("good", "")
    crowded = shape_checks.of_sight(missed=0.01, unexplained=0.0, fill=0.6)
    assert crowded.state == "bad"
    assert "60 %" in crowded.found


@pytest.mark.parametrize(("missed", "expected"), [(0.03, "good"), (0.06, "fair"), (0.2, "bad"), (0.3, "bad")])
def test_what_the_hull_of_all_views_leaves_out_is_judged_as_was_measured(missed: float, expected: str) -> None:
    assert shape_checks.of_sight(missed=missed, unexplained=0.0, fill=0.1).state == expected


def test_pictures_are_alike_in_sharpness() -> None:
    assert picture_checks.of_sharpness(0.4, 0.1).state == "good"
    found = picture_checks.of_sharpness(0.9, 1.4)
    assert found.state == "bad"
    assert "1.40 px more than others" in found.found


def test_motion_is_untold_without_roots_and_bad_where_they_sway() -> None:
    assert shape_checks.of_motion(None).state == "untold"
    assert shape_checks.of_motion(0.3).state == "bad"


def test_a_failed_check_takes_the_trust_away_and_says_why() -> None:
    term = Term(name="outlines", less_mm3=2.0, more_mm3=2.0, why="outlines")
    volume = Budget(volume_mm3=100.0, terms=(term,), views=40).volume((90.0, 110.0))
    assert volume.trusted
    lost = checks.failed([picture_checks.of_scan({"complete": False}, FRAMES), shape_checks.of_motion(0.01)])
    distrusted = volume.distrusted(lost)
    assert not distrusted.trusted
    assert distrusted.verdict.startswith(checks.NO_VOLUME)
    assert "stopped after 3 pictures" in distrusted.verdict
    again = distrusted.distrusted(["another reason"])
    assert again.verdict.count(checks.NO_VOLUME) == 1
    assert again.verdict.endswith("another reason")


def test_a_tank_without_the_canisters_edges_takes_the_trust_away() -> None:
    unseen = picture_checks.of_canister(None, Scene(tank=Tank()))
    assert unseen.state == "bad"
    assert "how it is turned" in checks.failed((unseen,))[0]
    assert picture_checks.of_canister(None, Scene()).state == "untold"
