"""What the pictures leave open about tubes, and cameras without markers about shapes whose volume is known."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from rhizotwin.recon.calibration.cameras import BareUncertainty
from rhizotwin.recon.coverage.evidence import Evidence
from rhizotwin.recon.hull.leaves import Grid, Leaves
from rhizotwin.recon.optics import cameras
from rhizotwin.recon.optics.refraction import Optics
from rhizotwin.recon.tubes import tube_fit, tubes
from rhizotwin.recon.uncertainty import bare_uncertainty, tube_uncertainty
from rhizotwin.recon.uncertainty.budget import NINETY, Term
from rhizotwin.recon.uncertainty.canister_uncertainty import CUBE_MM, misread
from rhizotwin.recon.uncertainty.posterior import Posterior
from tests.recon.hull.blocks import block
from tests.recon.hull.exact_pictures import ring_of, views_of
from tests.recon.strings import TRUNK, TWIG, at_rest, pictured, strung


def estimated(seen: Evidence, found: tubes.Tubes) -> tuple[dict[str, Term], float]:
    """Return the terms of tubes by name, and the share of the pictures that they do not explain."""
    px_a_mm = float(np.median(np.linalg.norm(seen.project(TRUNK).du, axis=-1)))
    made = tube_uncertainty.estimate(Posterior.compute(at_rest(found, px_a_mm=px_a_mm, seen=seen)))
    return {term.name: term for term in made.terms}, made.unexplained


def test_true_tubes_have_little_uncertainty_and_a_twig_is_missed() -> None:
    true = strung(TRUNK, TWIG, radius_mm=0.25)
    seen, volume = pictured(true), np.pi * 0.25**2 * true.length_mm
    whole, _ = estimated(seen, true)
    assert max(max(term.less_mm3, term.more_mm3) for term in whole.values()) < 0.05 * volume
    assert whole["missing roots"].more_mm3 < 0.002 * volume
    lacking, unexplained = estimated(seen, strung(TRUNK, radius_mm=0.25))
    assert 0.6 < lacking["missing roots"].more_mm3 / (np.pi * 0.25**2 * 15.0) < 1.4
    assert lacking["missing roots"].less_mm3 == 0.0
    assert 0.2 < unexplained < 0.4  # a third of the length, aslant and partly beside the trunk


def test_a_thick_root_does_not_count_as_crowded_thin_roots() -> None:
    thick, thin = (strung(TRUNK, radius_mm=radius_mm) for radius_mm in (2.0, 0.25))
    systems = [at_rest(found, px_a_mm=4.0, seen=pictured(found)) for found in (thick, thin)]
    fills = [tube_uncertainty.estimate(Posterior.compute(system)).fill for system in systems]
    assert fills[0] < 0.05
    assert fills[1] > 0.2


def test_swollen_tubes_are_pulled_back() -> None:
    true = strung(TRUNK, radius_mm=0.25)
    terms, _ = estimated(pictured(true), tubes.with_geometry(true, true.centre_mm, 1.1 * true.radius_mm))
    volume = np.pi * 0.275**2 * true.length_mm
    assert 0.1 * volume < terms["radii, residual gradient"].less_mm3 < 0.3 * volume
    assert terms["radii, residual gradient"].more_mm3 == 0.0
    assert terms["area"].less_mm3 > 0.1 * volume


def test_two_touching_roots_taken_for_one_look_flat() -> None:
    """Drawn as one round root of the same mean width, they have 1.34 times their volume, of which the term allows for most."""
    beside = TRUNK + np.array([1.2, 0.0, 0.0])
    one = strung(0.5 * (TRUNK + beside), radius_mm=0.6 * (1.0 + 2.0 / np.pi))
    volume = float(np.pi * one.radius_mm[0] ** 2 * one.length_mm)
    flat = estimated(pictured(strung(TRUNK, beside, radius_mm=0.6)), one)[0]["flat roots"]
    assert 0.15 * volume < flat.less_mm3 < 0.27 * volume
    assert flat.more_mm3 == 0.0
    single = strung(TRUNK, radius_mm=0.3)
    assert estimated(pictured(single), single)[0]["flat roots"].less_mm3 == 0.0


def test_noise_in_the_pictures_comes_out_in_the_diameters() -> None:
    """Fitted to pictures with noise, diameters miss the truth by what is told or less: what neighbours share is not counted."""
    true = strung(TRUNK, TWIG, radius_mm=0.25)
    seen = pictured(true, noise=0.02)
    fitted = tube_fit.fit(seen, true, np.zeros(len(true.radius_mm), bool), steps=6).tubes
    system = at_rest(fitted, px_a_mm=4.0, seen=seen)
    sigma, wrong = Posterior.compute(system).radius_sigma_mm, fitted.radius_mm - 0.25
    inner = np.ones(len(wrong), bool)
    inner[[int(nodes[k]) for nodes in fitted.branches for k in (0, 1, -2, -1)]] = False  # ends and forks share pixels
    assert 0.2 < np.sqrt(np.mean(wrong[inner] ** 2) / np.mean(sigma[inner] ** 2)) < 1.6


GRID = Grid.over(np.array([-32.0, -32.0, -32.0]), np.array([32.0, 32.0, 0.0]), 1.0)


def cube_at(x_mm: int) -> Leaves:
    """Return a cube of 4 mm whose middle is at (x, 0, -10)."""
    return block(GRID, np.argwhere(np.ones((4, 4, 4))) + np.array([x_mm - 2, -2, -12]) - np.asarray(GRID.origin_mm))


def terms_at(x_mm: int, *, scale: float = 0.0, azimuth_rad: float = 0.0, lift_mm: float = 0.0):
    known = BareUncertainty(scale=scale, azimuth_rad=azimuth_rad, lift_mm=lift_mm, mm_per_px=0.5)
    return bare_uncertainty.camera_terms(known, cube_at(x_mm), views=25, mm3_per_px=48.0)


def test_a_scale_counts_three_times() -> None:
    scale, cameras = terms_at(0, scale=0.001)
    grown = 64.0 * (1.0 + NINETY * 0.001) ** 3 - 64.0
    assert scale.less_mm3 == scale.more_mm3 == pytest.approx(grown, rel=0.01)
    assert cameras.more_mm3 == 0.0


def test_an_angle_counts_by_distance_and_a_lift_everywhere() -> None:
    far, farther = (terms_at(x, azimuth_rad=0.01)[1] for x in (10, 20))
    away = np.sqrt(10.0**2 + 2.0 * 15.0 / 12.0)  # the middles of four cells a side scatter by sqrt(15 / 12)
    assert far.more_mm3 == pytest.approx(NINETY * 0.01 * away / np.sqrt(2.0) / 0.5 * 48.0, rel=1e-3)
    assert farther.more_mm3 == pytest.approx(2.0 * far.more_mm3, rel=0.02)
    assert far.less_mm3 == pytest.approx(0.2 * far.more_mm3)
    assert [terms_at(x, lift_mm=0.1)[1].more_mm3 for x in (0, 20)] == [pytest.approx(NINETY * 0.1 / 0.5 * 48.0)] * 2
    assert bare_uncertainty.camera_terms(None, cube_at(0), views=20, mm3_per_px=48.0) == ()


SCENE = ring_of(3)
BELIEVED, VIEWS = Optics.from_scene(SCENE), views_of(SCENE)
OTHERS = {
    "wall": replace(BELIEVED, inner_radius_mm=BELIEVED.inner_radius_mm - 0.3),
    "radius": replace(BELIEVED, outer_radius_mm=BELIEVED.outer_radius_mm + 0.7, inner_radius_mm=BELIEVED.inner_radius_mm + 0.7),
}
POINT_MM = np.array([[22.0, -14.0, -70.0]])


def found(true: Optics, point: np.ndarray) -> np.ndarray:
    """Return where a point is found that is seen through another canister."""
    seen = [(view, cameras.project_inner(view, true, point[None])) for view in VIEWS]

    def off(at: np.ndarray) -> np.ndarray:
        return np.concatenate([(cameras.project_inner(view, BELIEVED, at[None]) - px).ravel() for view, px in seen])

    return np.asarray(least_squares(off, point, x_scale=0.01).x)


@pytest.mark.parametrize("name", OTHERS)
def test_misread_is_what_looking_for_every_point_gives(name: str) -> None:
    true = OTHERS[name]
    ends = [[found(true, POINT_MM[0] + 0.5 * side * CUBE_MM * np.eye(3)[axis]) for side in (-1.0, 1.0)] for axis in range(3)]
    slowly = float(np.linalg.det(np.array([(high - low) / CUBE_MM for low, high in ends])) - 1.0)
    quickly = misread(VIEWS, BELIEVED, true, POINT_MM)
    assert quickly == pytest.approx(slowly, rel=1e-3)
    assert abs(slowly) > 1e-5
    assert misread(VIEWS, BELIEVED, BELIEVED, POINT_MM) == pytest.approx(0.0, abs=1e-7)
