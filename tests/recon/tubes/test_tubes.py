"""Tubes: the pictures they cast, and how a fit finds them again."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import erf

from rhizotwin.recon.coverage.evidence import Nodes
from rhizotwin.recon.tubes import tube_fit, tube_picture, tube_profiles, tubes
from rhizotwin.recon.tubes.tube_picture import Rendering
from tests.recon.strings import TRUNK, TWIG, line, pictured, strung


def test_a_lateral_is_as_thick_as_it_is_from_its_parents_axis_on():
    """Its first segment reaches from the axis of a thick parent to beyond the skin: no cone of the parent's width."""
    thick = strung(TRUNK, radius_mm=0.7)
    at = int(np.argmin(np.abs(thick.centre_mm[:, 2] + 30.0)))
    way = thick.centre_mm[at] + np.outer([1.4, 2.0, 2.6, 3.2], [1.0, 0.0, 0.0])
    hung = np.array([at, *(len(thick.centre_mm) + np.arange(4))])
    nodes, radii = np.concatenate([thick.centre_mm, way]), np.concatenate([thick.radius_mm, np.full(4, 0.15)])
    both = tubes.Tubes(nodes, radii, (*thick.branches, hung))
    alone = tubes.Tubes(np.concatenate([thick.centre_mm[at : at + 1], way]), np.full(5, 0.15), (np.arange(5),))
    begin, end = both.segment_radii
    np.testing.assert_array_equal(begin[-4:], 0.15)
    np.testing.assert_array_equal(end, both.radius_mm[both.segments[:, 1]])
    parent, lateral, drawn = (np.array(pictured(system).coverage) for system in (thick, alone, both))
    np.testing.assert_allclose(drawn, 1.0 - (1.0 - parent) * (1.0 - lateral), atol=1e-3)


def across_mm(found: tubes.Tubes, true: tubes.Tubes) -> np.ndarray:
    """Return how far nodes lie beside the true ones, across the roots."""
    off = found.centre_mm - true.centre_mm
    return np.linalg.norm(off - (off * true.tangents).sum(axis=1, keepdims=True) * true.tangents, axis=1)


def test_fit_finds_moved_and_swollen_tubes_again():
    true = strung(TRUNK, TWIG, radius_mm=0.25)
    seen = pictured(true)
    rng = np.random.default_rng(3)
    wave = 0.15 * np.sin(np.arange(len(true.radius_mm)) / 4.0)[:, None] * rng.normal(size=3)
    start = tubes.with_geometry(true, true.centre_mm + wave, np.full(len(true.radius_mm), 0.15))
    fit = tube_fit.fit(seen, start, np.zeros(len(true.radius_mm), bool), steps=15)
    off = across_mm(fit.tubes, true)
    assert max(np.median(off[branch[3:-3]]) for branch in true.branches) < 0.03
    assert np.median(fit.tubes.radius_mm) == pytest.approx(0.25, rel=0.03)
    assert np.median(fit.residual.visible) > 0.8


def test_a_bulb_on_a_root_does_not_turn_about_its_middle():
    """From 3 degrees aside, its centre line turned on to 13 degrees in 16 steps, since a ball that turns looks the same."""
    true = strung(line((0.0, 0.0, -29.0), (0.0, 0.0, -62.0)), radius_mm=0.8)
    along = true.centre_mm[:, 2] + 38.0
    radius = 0.8 + 8.2 * np.sqrt(np.maximum(0.0, 1.0 - np.abs(along / 9.0) ** 2.5))
    true = tubes.with_geometry(true, true.centre_mm, radius)
    aside = np.maximum(along + 9.0, 0.0) * np.tan(np.deg2rad(3.0))
    start = tubes.with_geometry(true, true.centre_mm + aside[:, None] * [1.0, 0.0, 0.0], radius)
    found = tube_fit.fit(pictured(true), start, np.ones(len(radius), bool), steps=16).tubes
    inner = np.abs(along) < 5.0
    assert np.abs(found.centre_mm[inner, :2]).max() < 0.02
    np.testing.assert_allclose(found.radius_mm[inner], radius[inner], atol=0.05)


def test_flanks_of_a_ball_stay_if_its_centre_line_turns():
    along, way = np.linspace(-6.0, 6.0, 121), np.array([0.6, 0.0, 0.8])
    ball = tubes.Tubes(np.outer(along, way), np.sqrt(10.0**2 - along**2), (np.arange(121),))
    turn = np.zeros((121, 4))
    turn[:, 1] = 0.01 * along
    moved = (tube_fit.flank_motion(ball) @ turn.ravel()).reshape(121, 4)
    np.testing.assert_allclose(moved[1:-1], 0.0, atol=1e-5)
    rod = tubes.with_geometry(ball, ball.centre_mm, np.full(121, 3.0))
    np.testing.assert_allclose((tube_fit.flank_motion(rod) @ turn.ravel()).reshape(121, 4), turn)


def test_radii_of_tubes_that_share_pixels_do_not_swing():
    """Two roots that run through each other, begun too thin: whole steps swung by an eighth of their area."""
    true = strung(*(line((x, y, -20.0), (-x, -y, -40.0)) for x, y in ((0.2, 0.3), (0.3, -0.3))), radius_mm=0.25)
    seen, fixed = pictured(true), np.zeros(len(true.radius_mm), bool)
    found, areas = tubes.with_geometry(true, true.centre_mm, 0.85 * true.radius_mm), []
    for _ in range(12):
        found = tube_fit.fit(seen, found, fixed, steps=1).tubes
        areas.append(np.square(found.radius_mm / 0.25).mean())
    assert np.abs(np.diff(areas[4:])).max() < 0.03
    assert abs(np.mean(areas[-2:]) - 1.0) < 0.03


def test_a_lateral_leaves_its_parent_where_its_course_points_to():
    """Its path ran down inside the thick parent, where no picture says where it should not; now it is as long as two straight lines."""
    parent = line((0.0, 0.0, -20.0), (0.0, 0.0, -50.0))
    inner, outer = line((0.0, 0.0, -25.0), (1.2, 0.0, -33.0)), line((1.2, 0.0, -33.0), (12.0, 0.0, -33.0))
    course = np.concatenate([inner, outer[1:]])
    system = tubes.place_nodes([parent, course], [np.full(len(parent), 1.5), np.full(len(course), 0.3)])
    found = tubes.trim_inside_parents(system)
    np.testing.assert_allclose(found.centre_mm[found.branches[1][0]], (0.0, 0.0, -33.0), atol=0.7)
    assert system.length_mm > 30.0 + 17.5
    assert found.length_mm == pytest.approx(30.0 + 12.0, abs=0.7)


def test_a_tube_that_no_view_sees_has_no_say():
    seen, system = pictured(strung(TRUNK)), strung(TRUNK)
    away = tubes.with_geometry(system, system.centre_mm + np.array([0.0, 0.0, 500.0]), system.radius_mm)
    drawn = Rendering.draw(seen, away)
    assert (np.array(drawn.passing) == 1.0).all()
    assert not tube_profiles.profiles(drawn).residual_gradient().hessian.any()


def drawn_by_the_formula(system: tubes.Tubes, at: Nodes, view: int, blur_px: float) -> np.ndarray:
    """Return the optical depth (300, 400) of opaque tubes in one view, every segment wherever its formula is not nothing."""
    px, du, dv, seen = at.px[view], at.du[view], at.dv[view], at.visible[view]
    sigma = np.hypot(blur_px, 12.0**-0.5) * np.sqrt(2.0)
    whole = np.zeros((300, 400))
    for (a, b), (before, after), *radii in zip(system.segments, system.segment_neighbours, *system.segment_radii, strict=True):
        if not (seen[a] and seen[b]):
            continue
        length = np.linalg.norm(px[b] - px[a])
        t = (px[b] - px[a]) / length
        w_a, w_b = (radius * np.linalg.norm(t[0] * dv[end] - t[1] * du[end]) for radius, end in zip(radii, (a, b), strict=True))
        cap = radii[1] * np.linalg.norm(t[0] * du[b] + t[1] * dv[b]) if after == b else 0.0
        margin = 2.0 * (max(w_a, w_b) + cap + 3.0)
        low, high = px[[a, b]].min(axis=0) - margin, px[[a, b]].max(axis=0) + margin
        (left, top), (right, bottom) = (np.clip(end, 0.0, [400.0, 300.0]).astype(int) for end in (low, high))
        u, v = np.meshgrid(np.arange(left, right), np.arange(top, bottom))
        s, d = (u - px[a, 0]) * t[0] + (v - px[a, 1]) * t[1], (v - px[a, 1]) * t[0] - (u - px[a, 0]) * t[1]
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
        whole[top:bottom, left:right] -= np.where((begun >= 0.0) & (ended < 0.0), np.log1p(-np.minimum(covered, 0.995)), 0.0)
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
    assert across_mm(found, truth).max() < 0.01
    assert np.median(found.radius_mm) == pytest.approx(radius_mm, rel=2e-3)
