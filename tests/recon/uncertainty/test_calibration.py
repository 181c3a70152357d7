"""Calibration factors apply within their regimes only, and scale the half-widths of intervals."""

import numpy as np
import pytest

from rhizotwin.recon.uncertainty import calibration
from rhizotwin.recon.uncertainty.budget import Budget, Term, part_interval
from rhizotwin.recon.uncertainty.calibration import NOT_CALIBRATED, Calibration, find_calibration

TERMS = (Term.symmetric("outlines", 3.0, "outlines"), Term(name="occluded", less_mm3=0.0, more_mm3=4.0, why="hidden"))


def find(**changes) -> Calibration:
    usual = {"views": 24, "px_a_mm": 2.0, "missed": 0.0, "translucent": False, "width_mm": None, "hidden": 0.0}
    return find_calibration(**usual | changes)


@pytest.mark.parametrize("changes", [{"views": 8}, {"px_a_mm": 12.0}])
def test_scans_unlike_the_calibration_scans_are_not_calibrated(changes) -> None:
    assert find(**changes) == NOT_CALIBRATED
    assert NOT_CALIBRATED.factor("volume_mm3") == 1.0


def test_the_first_regime_that_applies_is_used() -> None:
    assert find().regime == find(width_mm=2.0).regime == "clear"
    assert find(hidden=0.1).regime == "hidden parts"
    assert find(hidden=0.1, width_mm=0.3).regime == "thin roots"
    assert find(hidden=0.1, width_mm=0.3, translucent=True).regime == "translucent roots"
    assert find(hidden=0.1, width_mm=0.3, translucent=True, missed=0.2).regime == "inconsistent views"


def test_a_factor_scales_both_half_widths_and_those_of_parts() -> None:
    halved = Calibration(regime="test", factors={"volume_mm3": 0.5})
    plain, scaled = (Budget(volume_mm3=100.0, terms=TERMS, views=24, calibration=one) for one in (NOT_CALIBRATED, halved))
    assert scaled.interval_mm3 == pytest.approx(0.5 * (100.0 + np.array(plain.interval_mm3)))
    assert part_interval(TERMS, whole_mm3=100.0, part_mm3=100.0, calibration=halved) == pytest.approx(scaled.interval_mm3)


def test_factors_are_stored_positive_and_none_in_old_results() -> None:
    made = Calibration(regime="hidden top", factors={"tips": 1.5})
    assert Calibration.from_plain(made.plain()) == made
    assert Calibration.from_plain(None) == NOT_CALIBRATED
    assert calibration._table()
    assert all(factor > 0.0 for factors in calibration._table().values() for factor in factors.values())
