"""The drawing kernel against its formula, pixel by pixel."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import erf

from rhizotwin.recon.coverage.evidence import Nodes
from rhizotwin.recon.tubes import tube_fit, tube_picture, tubes
from tests.recon.strings import line, pictured, strung


def drawn_by_the_formula(system: tubes.Tubes, at: Nodes, view: int, blur_px: float) -> np.ndarray:
    """Return the optical depth (300, 400) of opaque tubes in one view, every segment over the whole picture."""
    px, du, dv, seen = at.px[view], at.du[view], at.dv[view], at.visible[view]
    u, v = np.meshgrid(np.arange(400.0), np.arange(300.0))
    sigma = np.hypot(blur_px, 12.0**-0.5) * np.sqrt(2.0)
    whole = np.zeros(u.shape)
    for (a, b), (before, after), *radii in zip(system.segments, system.segment_neighbours, *system.segment_radii, strict=True):
        if not (seen[a] and seen[b]):
            continue
        length = np.linalg.norm(px[b] - px[a])
        t = (px[b] - px[a]) / length
        w_a, w_b = (radius * np.linalg.norm(t[0] * dv[end] - t[1] * du[end]) for radius, end in zip(radii, (a, b), strict=True))
        s, d = (u - px[a, 0]) * t[0] + (v - px[a, 1]) * t[1], (v - px[a, 1]) * t[0] - (u - px[a, 0]) * t[1]
        cap = radii[1] * np.linalg.norm(t[0] * du[b] + t[1] * dv[b]) if after == b else 0.0
        w = w_a + (w_b - w_a) * np.clip(s / length, 0.0, 1.0)
        w *= np.sqrt(1.0 - np.clip((s - length) / cap, 0.0, 1.0) ** 2) if cap else 1.0
        box_a, box_b = np.maximum(np.sqrt(t**2 + 6.0 * blur_px**2), 0.1)

        def side(x: np.ndarray, box_a: float = box_a, box_b: float = box_b) -> np.ndarray:
            """Integrate the trapezoid of the boxes over the half-line before x."""
            shifts = 0.5 * np.array([box_a + box_b, box_a - box_b, box_b - box_a, -box_a - box_b])
            ramps = [np.maximum(x + shift, 0.0) ** 2 for shift in shifts]
            return 0.5 * (ramps[0] - ramps[1] - ramps[2] + ramps[3]) / (box_a * box_b)

        covered = side(d + w) - side(d - w)
        begun, ended = (
            (u - px[k, 0]) * n[0] + (v - px[k, 1]) * n[1] for k, n in zip((a, b), cuts(px, seen, [before, a, b, after]), strict=True)
        )
        if cap:
            covered, ended = covered * 0.5 * (1.0 - erf((ended - cap) / sigma)), np.full(u.shape, -np.inf)
        whole -= np.where((begun >= 0.0) & (ended < 0.0), np.log1p(-np.minimum(covered, 0.995)), 0.0)
    return whole


def cuts(px: np.ndarray, seen: np.ndarray, nodes: list[int]) -> list[np.ndarray]:
    """Return the normals at the middle two of four nodes: halfway between the segments that meet, or as the one beyond goes."""
    ways = np.diff(px[nodes], axis=0)
    long = np.linalg.norm(ways, axis=1)
    ways /= np.maximum(long, 1e-3)[:, None]
    own = ways[1]
    meets = [
        seen[node] and length > 1e-3 and way @ own > 0.0
        for node, length, way in ((nodes[0], long[0], ways[0]), (nodes[3], long[2], ways[2]))
    ]
    found = []
    for mine, other in ((0, 1), (1, 0)):
        beyond = ways[2 * other]
        normal = ways[2 * mine] + own if meets[mine] else beyond if meets[other] and beyond @ own > 0.5**0.5 else own
        found.append(normal / np.linalg.norm(normal))
    return found


@pytest.mark.parametrize(("blur_px", "view"), [(0.0, 0), (0.6, 4)])
def test_pictures_of_tubes_are_those_of_the_formula(blur_px: float, view: int) -> None:
    """Level, upright, slanting and bent ones, beside each other and through each other, and across the picture's edges."""
    bent = ((12.0, 0.0, -35.0), (15.0, 0.0, -40.0), (12.0, 0.0, -45.0), (14.0, 3.0, -47.0))
    ways = [((-20.0, 0.0, -30.0), (20.0, 0.0, -30.0)), ((0.0, 0.0, -25.0), (0.0, 0.0, -29.0)), ((3.0, 4.0, -30.0), (-15.0, 9.0, -44.0))]
    beyond = [((8.0, -6.0, -80.0), (8.0, -6.0, -130.0)), ((0.0, 0.0, 30.0), (1.0, 0.0, -30.0))]
    system = strung(*(line(*ends) for ends in (*ways, *beyond, bent)))
    system = tubes.with_geometry(system, system.centre_mm, np.linspace(0.1, 0.7, len(system.radius_mm)))
    seen = pictured(system)
    at = seen.project(system.centre_mm)
    found = np.array(tube_picture.transmittance(replace(seen, blur_px=blur_px), system, at)).reshape(seen.bank.count, 300, 400)
    assert not at.visible.all()
    whole = drawn_by_the_formula(system, at, view, blur_px)
    np.testing.assert_allclose(found[view], np.exp(-whole), atol=1.5e-3)  # tails under 1e-4 are left out
    assert 1.0 - np.exp(-whole).min() > 0.9


@pytest.mark.parametrize("radius_mm", [0.3, 1.2])
def test_a_wide_tube_that_zigzags_is_fitted_straight(radius_mm: float) -> None:
    """Wider than its segments are long: notches at bends once pushed nodes to and fro, and made tubes 2 % too wide."""
    truth = strung(line((-8.0, -6.0, -30.0), (8.0, 6.0, -50.0)), radius_mm=radius_mm)
    seen = pictured(truth)
    aside = np.cross(truth.tangents, [0.0, 0.0, 0.03]) * (-1.0) ** np.arange(len(truth.radius_mm))[:, None]
    start = tubes.with_geometry(truth, truth.centre_mm + aside, 0.97 * truth.radius_mm)
    found = tube_fit.fit(seen, start, np.zeros(len(aside), bool), steps=12).tubes
    off = found.centre_mm - truth.centre_mm
    off -= (off * truth.tangents).sum(axis=1, keepdims=True) * truth.tangents
    assert np.linalg.norm(off, axis=1).max() < 0.01
    assert np.median(found.radius_mm) == pytest.approx(radius_mm, rel=2e-3)
