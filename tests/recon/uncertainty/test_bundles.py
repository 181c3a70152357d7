"""Length hidden in bundles: closed forms of two roots that spread from a point, and nothing for laterals and crossings."""

import math

import numpy as np
import pytest

from rhizotwin.recon.uncertainty.bundles import bundled_length_mm
from rhizotwin.scenes.rsml import Root

PX_A_MM = 4.0
SEPARATE_MM = math.pi / PX_A_MM


def line(angle_deg: float, *, begin=(0.0, 0.0, 0.0), diameter_mm: float = 0.4, parent: int = -1) -> Root:
    """Return a root of 40 mm that grows downwards at an angle in the plane y = 0."""
    way, angle = np.linspace(0.0, 40.0, 81)[:, None], math.radians(angle_deg)
    points = np.asarray(begin) + way * [math.sin(angle), 0.0, -math.cos(angle)]
    return Root(points_mm=points, diameters_mm=np.full(81, diameter_mm), order=parent + 1, parent=parent)


@pytest.mark.parametrize("half_deg", [3.0, 6.0, 10.0])
def test_two_roots_that_spread_from_a_point(half_deg: float) -> None:
    """Their surfaces are separate at the distance s of the apex where 2 s sin(half) exceeds their diameter by the resolution."""
    reach_mm = 0.4 + SEPARATE_MM
    each_mm = reach_mm / (2.0 * math.sin(math.radians(half_deg))) - reach_mm / math.sin(math.radians(45.0))
    found_mm = bundled_length_mm([line(-half_deg), line(half_deg)], PX_A_MM)
    assert found_mm == pytest.approx(2.0 * 2.0 * each_mm, abs=0.8)  # both, twice; sampled every 0.2 mm


SIBLINGS = [line(0.0, diameter_mm=1.2), *(line(60.0, begin=(0.0, 0.0, z), parent=0) for z in (-20.0, -21.0))]
THICK = [line(angle, diameter_mm=3.0) for angle in (-5.0, 5.0)]
LATERAL = [line(0.0), line(60.0, begin=(0.0, 0.0, -20.0), parent=0)]
CROSSING = [line(0.0), line(10.0, begin=(-3.5, 0.0, 0.0))]
ON_TAPROOT = [line(0.0, diameter_mm=1.2), line(20.0, begin=(0.0, 0.0, -10.0), parent=0)]


NOTHING = {
    "lateral": LATERAL,
    "crossing": CROSSING,
    "taproot": ON_TAPROOT,
    "siblings": SIBLINGS,
    "one": LATERAL[:1],
    "thick": THICK,
    "none": [],
}


@pytest.mark.parametrize("roots", NOTHING.values(), ids=NOTHING)
def test_nothing_is_hidden_elsewhere(roots: list[Root]) -> None:
    assert bundled_length_mm(roots, PX_A_MM) == 0.0


def test_larger_pictures_separate_sooner() -> None:
    fan = [line(angle) for angle in (-12.0, -4.0, 4.0, 12.0)]
    coarse, fine = (bundled_length_mm(fan, scale) for scale in (2.0, 8.0))
    assert 0.0 < fine < coarse / 2.0
    assert bundled_length_mm(fan, 0.0) == 0.0
