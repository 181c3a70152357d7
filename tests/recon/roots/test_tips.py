"""Tips are found where the pictures say that roots end."""

import numpy as np
import pytest

from rhizotwin.recon.roots import tips
from rhizotwin.recon.tubes import tubes
from tests.recon.strings import line, pictured, strung

SHORT = line((0.0, 0.0, -20.0), (0.0, 0.0, -40.0))
SIDEWAYS = line((0.0, 0.0, -28.0), (12.0, 3.0, -34.0))
PX_A_MM = 2.6
"""Sideways in the middle of the pictures; up and down the water does not magnify, there it is 1.7."""


def off(found: tubes.Tubes, true: tubes.Tubes) -> np.ndarray:
    """Return how far found tips lie beyond the true ones along the roots."""
    last = [nodes[-1] for nodes in true.branches]
    return np.asarray(((found.centre_mm[last] - true.centre_mm[last]) * true.tangents[last]).sum(axis=1))


def with_tips_moved(true: tubes.Tubes, by_mm: float) -> tubes.Tubes:
    centre = true.centre_mm.copy()
    for nodes in true.ends:
        centre[nodes] = tips._stretch(centre[nodes], by_mm)
    np.testing.assert_allclose(off(tubes.with_geometry(true, centre, true.radius_mm), true), by_mm, atol=1e-6)
    return tubes.with_geometry(true, centre, true.radius_mm)


@pytest.mark.parametrize(("radius_mm", "by_mm"), [(0.15, -0.8), (0.15, 0.8), (0.4, 0.0), (1.2, -0.8), (1.2, 0.8)])
def test_tips_that_are_off_come_back(radius_mm: float, by_mm: float) -> None:
    true = strung(SHORT, SIDEWAYS, radius_mm=radius_mm)
    found = tips.place_tips(pictured(true), with_tips_moved(true, by_mm), PX_A_MM)
    assert np.abs(off(found, true)).max() < (0.29 if by_mm else 1e-3)  # half of a pixel up and down
    bears = true.branches[1][0]
    np.testing.assert_array_equal(found.centre_mm[: bears + 1], true.centre_mm[: bears + 1])  # laterals stay where they leave


def test_tips_one_at_a_time_are_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    true = strung(SHORT, SIDEWAYS, radius_mm=0.4)
    evidence, moved = pictured(true), with_tips_moved(true, 0.8)
    together = tips.place_tips(evidence, moved, PX_A_MM).centre_mm
    monkeypatch.setattr(tips, "_AT_ONCE", 1)
    np.testing.assert_array_equal(tips.place_tips(evidence, moved, PX_A_MM).centre_mm, together)
