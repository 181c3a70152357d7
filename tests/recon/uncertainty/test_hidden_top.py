"""The top of a taproot behind the net pot, extrapolated from what is seen below."""

import numpy as np
import pytest

from rhizotwin.recon.uncertainty import hidden_top
from tests.recon.strings import root

GAP_MM = 4.0


@pytest.mark.parametrize("lean_mm", [0.0, 30.0])
def test_a_cylinder_goes_on_as_it_begins(lean_mm: float) -> None:
    found = hidden_top.estimate_hidden([root((0.0, 0.0, -12.0), (lean_mm, 0.0, -52.0), diameters=(2.0, 2.0))], [GAP_MM])
    assert found is not None
    length_mm = 4.0 * np.hypot(lean_mm, 40.0) / 40.0
    assert found.length_mm == pytest.approx(length_mm)
    assert found.volume_mm3 == pytest.approx(np.pi * length_mm)
    assert found.interval_mm3 == pytest.approx((found.volume_mm3, found.volume_mm3))
    assert "height_mm = 10" in found.warning(is_added=False)


def test_a_cone_has_an_interval_that_holds_what_it_has() -> None:
    found = hidden_top.estimate_hidden([root((0.0, 0.0, -12.0), (0.0, 0.0, -52.0), diameters=(2.0, 1.0))], [GAP_MM])
    assert found is not None
    true_mm3 = np.pi / 3.0 * 4.0 * (1.0 + 1.05 + 1.05**2)
    assert found.interval_mm3[0] < true_mm3 < found.interval_mm3[1]


@pytest.mark.parametrize(("end_mm", "gap_mm"), [((0.0, 0.0, -52.0), 0.0), ((40.0, 0.0, -14.0), GAP_MM)], ids=["seen", "leaves level"])
def test_nothing_is_hidden(end_mm: tuple[float, float, float], gap_mm: float) -> None:
    assert hidden_top.estimate_hidden([root((0.0, 0.0, -12.0), end_mm)], [gap_mm]) is None


def test_the_extrapolation_is_a_term_of_the_budget() -> None:
    found = hidden_top.HiddenTop(length_mm=4.0, share=0.1, volume_mm3=10.0, interval_mm3=(6.0, 15.0))
    assert (found.term.less_mm3, found.term.more_mm3) == (4.0, 5.0)
