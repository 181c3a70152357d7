"""Calibration factors apply within their regimes only, and scale the half-widths of intervals."""

import pytest

from rhizotwin.recon.uncertainty import calibration
from rhizotwin.recon.uncertainty.budget import Budget, Term, part_interval
from rhizotwin.recon.uncertainty.calibration import NOT_CALIBRATED, Calibration, find_calibration

TERMS = (Term.symmetric("outlines", 3.0, "outlines"), Term(name="occluded", less_mm3=0.0, more_mm3=4.0, why="hidden"))


@pytest.mark.parametrize(("views", "px_a_mm"), [(8, 2.0), (100, 2.0), (24, 0.7), (24, 12.0)])
def test_scans_unlike_the_calibration_scans_are_not_calibrated(views: int, px_a_mm: float) -> None:
    assert find_calibration(views=views, px_a_mm=px_a_mm, hidden=0.0, consistent=True) == NOT_CALIBRATED
    assert NOT_CALIBRATED.factor("volume_mm3") == 1.0


def test_regimes() -> None:
    def regime(hidden: float, consistent: bool) -> str | None:
        return find_calibration(views=24, px_a_mm=2.0, hidden=hidden, consistent=consistent).regime

    assert len({regime(0.0, True), regime(0.1, True), regime(0.1, False)}) == 3
    assert regime(0.0, False) == regime(0.1, False)


def test_a_factor_scales_both_half_widths_and_those_of_parts() -> None:
    halved = Calibration(regime="test", factors={"volume_mm3": 0.5})
    plain, scaled = (Budget(volume_mm3=100.0, terms=TERMS, views=24, calibration=one) for one in (NOT_CALIBRATED, halved))
    for end in (0, 1):
        assert scaled.interval_mm3[end] - 100.0 == pytest.approx(0.5 * (plain.interval_mm3[end] - 100.0))
    whole = part_interval(TERMS, whole_mm3=100.0, part_mm3=100.0, calibration=halved)
    assert whole == pytest.approx(scaled.interval_mm3)


def test_stored_calibrations_are_read_again_and_old_results_have_none() -> None:
    made = Calibration(regime="hidden top", factors={"tips": 1.5})
    assert Calibration.from_plain(made.plain()) == made
    assert Calibration.from_plain(None) == NOT_CALIBRATED


def test_every_committed_factor_is_positive() -> None:
    table = calibration._table()
    assert table
    assert all(factor > 0.0 for factors in table.values() for factor in factors.values())
