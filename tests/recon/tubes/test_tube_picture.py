"""The drawing kernel against its formula, pixel by pixel."""

import numpy as np
import pytest
from scipy.special import erf

from rhizotwin.recon.coverage.evidence import Nodes
from rhizotwin.recon.tubes import tube_picture, tubes
from tests.recon.lines import line
from tests.recon.strings import pictured, strung


def drawn_by_the_formula(system: tubes.Tubes, at: Nodes, view: int, blur_px: float) -> np.ndarray:
    """Return the optical depth (300, 400) of opaque tubes in one view, every segment over the whole picture."""
    px, du, dv, seen = at.px[view], at.du[view], at.dv[view], at.seen[view]
    u, v = np.meshgrid(np.arange(400.0), np.arange(300.0))
    sigma = np.hypot(blur_px, 12.0**-0.5) * np.sqrt(2.0)
    whole = np.zeros(u.shape)
    for (a, b), *radii in zip(system.segments, *system.segment_radii, strict=True):
        if not (seen[a] and seen[b]):
            continue
        length = np.linalg.norm(px[b] - px[a])
        t = (px[b] - px[a]) / length
        w_a, w_b = (radius * np.linalg.norm(t[0] * dv[end] - t[1] * du[end]) for radius, end in zip(radii, (a, b), strict=True))
        s, d = (u - px[a, 0]) * t[0] + (v - px[a, 1]) * t[1], (v - px[a, 1]) * t[0] - (u - px[a, 0]) * t[1]
        w = w_a + (w_b - w_a) * np.clip(s / length, 0.0, 1.0)
        box_a, box_b = np.maximum(np.sqrt(t**2 + 6.0 * blur_px**2), 0.1)

        def side(x: np.ndarray, box_a: float = box_a, box_b: float = box_b) -> np.ndarray:
            """Integrate the trapezoid of the boxes over the half-line before x."""
            shifts = 0.5 * np.array([box_a + box_b, box_a - box_b, box_b - box_a, -box_a - box_b])
            ramps = [np.maximum(x + shift, 0.0) ** 2 for shift in shifts]
            return 0.5 * (ramps[0] - ramps[1] - ramps[2] + ramps[3]) / (box_a * box_b)

        covered = np.minimum(side(d + w) - side(d - w), 0.995)
        whole -= 0.5 * (erf(s / sigma) - erf((s - length) / sigma)) * np.log1p(-covered)
    return whole


@pytest.mark.parametrize("blur_px", [0.0, 0.6])
def test_pictures_of_tubes_are_those_of_the_formula(blur_px: float) -> None:
    """Level, upright and slanting ones, beside each other and through each other, and across the picture's edges."""
    ways = [((-20.0, 0.0, -30.0), (20.0, 0.0, -30.0)), ((0.0, 0.0, -25.0), (0.0, 0.0, -29.0)), ((3.0, 4.0, -30.0), (-15.0, 9.0, -44.0))]
    beyond = [((8.0, -6.0, -80.0), (8.0, -6.0, -130.0)), ((0.0, 0.0, 30.0), (1.0, 0.0, -30.0))]
    system = strung(*(line(*ends) for ends in (*ways, *beyond)))
    system = tubes.moved(system, system.centre_mm, np.linspace(0.1, 0.7, len(system.radius_mm)))
    seen = pictured(system)
    at = seen.project(system.centre_mm)
    found = np.array(tube_picture.optical_depth(seen, system, at, blur_px)).reshape(seen.bank.count, 300, 400)
    assert not at.seen.all()
    for view in (0, 4):
        whole = drawn_by_the_formula(system, at, view, blur_px)
        np.testing.assert_allclose(np.exp(-found[view]), np.exp(-whole), atol=1.5e-3)  # tails under 1e-4 are left out
        assert 1.0 - np.exp(-whole).min() > 0.9
