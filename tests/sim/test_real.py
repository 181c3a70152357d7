"""What a real scan adds to the twin, against closed forms: walls, sway, hairs, refracting roots, dirt outside, the camera."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from rhizotwin.scenes import transfer
from rhizotwin.scenes.disturbances import Disturbances
from rhizotwin.scenes.model import Camera, CapturePlan, Ring, Scene
from rhizotwin.scenes.specimens import SphereSpecimen
from rhizotwin.sim import dirt
from rhizotwin.sim.exposure import expose
from rhizotwin.sim.hanging import HangingObject
from rhizotwin.sim.render import Renderer
from rhizotwin.sim.specimen import build_specimen
from rhizotwin.sim.world import draw_world, scene_for_reconstruction

pytestmark = pytest.mark.usefixtures("coarse_ball")
BALL = SphereSpecimen(diameter_mm=20.0, centre_mm=(0.0, 0.0, -60.0))
SMALL = Scene(camera=Scene().camera.resized((160, 120)), plan=CapturePlan(rings=(Ring(views=4),)), specimen=BALL)


@cache
def picture(wrong: Disturbances, *, view: int = 0, empty: bool = False) -> tuple[np.ndarray, np.ndarray]:
    scene = replace(SMALL, disturbances=wrong)
    solid = None if empty else build_specimen(scene)
    return Renderer(scene, draw_world(scene, seed=1), solid).view(view)


def test_an_oval_that_is_hardly_one_looks_as_a_cylinder() -> None:
    round_, _ = picture(Disturbances())
    oval, _ = picture(Disturbances(canister_out_of_round_mm=1e-6))
    assert np.quantile(np.abs(oval - round_), 0.99) < 0.01


def test_a_larger_canister_is_seen_wider_by_as_much() -> None:
    px_a_mm = SMALL.camera.focal_px[0] / np.sqrt(400.0**2 - 76.2**2)
    nominal, larger = (picture(Disturbances(canister_radius_error_mm=wrong), empty=True)[0][80] for wrong in (0.0, 2.0))
    first, then = (np.flatnonzero(row < 0.4) for row in (nominal, larger))
    assert np.ptp(then) - np.ptp(first) == pytest.approx(2.0 * 2.0 * px_a_mm, abs=1.5)


def test_what_hangs_sways_in_proportion_to_its_depth() -> None:
    solid = build_specimen(SMALL)
    hanging = HangingObject.of("specimen", solid.vertices, solid)
    moved = hanging.at((0.6, -0.2), 0.0) - solid.vertices
    top, middle, tip = (np.argmin(np.abs(solid.vertices[:, 2] - z)) for z in (-50.0, -60.0, -70.0))
    np.testing.assert_allclose(moved[[top, middle, tip]], np.outer([0.0, 0.5, 1.0], [0.6, -0.2, 0.0]), atol=1e-9)
    turned = hanging.at((0.0, 0.0), 30.0)
    assert np.arctan2(*turned[middle, 1::-1]) - np.arctan2(*solid.vertices[middle, 1::-1]) == pytest.approx(np.deg2rad(15.0))


def test_a_swaying_ball_is_seen_where_it_hangs() -> None:
    wrong = Disturbances(sway_mm=2.0)
    sway = np.array(draw_world(replace(SMALL, disturbances=wrong), seed=1).sway_mm)
    columns = []
    for view in (0, 1):
        _, coverage = picture(wrong, view=view)
        columns.append(float((coverage.sum(axis=0) @ np.arange(160)) / coverage.sum()))
    _, still = picture(Disturbances())
    middle = float((still.sum(axis=0) @ np.arange(160)) / still.sum())
    px_a_mm = 1.333 * SMALL.camera.focal_px[0] / 400.0  # a water cylinder enlarges what is at its axis by its index
    # views 0 and 1 look along -x and (the table turns counter-clockwise) +y of the canister; the ball's middle goes half the tip's way
    for column, aside in zip(columns, (sway[0, 1], sway[1, 0]), strict=True):
        assert abs(column - middle) == pytest.approx(abs(0.5 * aside * px_a_mm), abs=0.12)


def test_a_glassy_ball_takes_light_by_the_chords_of_refracted_rays() -> None:
    """A ray beside the middle by x radii passes it by x over the index; what the rim reflects comes from the panel, too."""
    image, coverage = picture(Disturbances(root_n=1.365, root_mu_per_mm=0.05))
    empty, _ = picture(Disturbances(), empty=True)
    row, columns = int(np.median(np.nonzero(coverage > 0.99)[0])), np.arange(160)
    wide = coverage[row].sum()
    aside = (columns - coverage[row] @ columns / wide) / (0.5 * wide)
    inside = np.abs(aside) < 0.95
    passed = (image / np.maximum(empty, 1e-6))[row, inside]
    expected = np.exp(-0.05 * 20.0 * np.sqrt(1.0 - (aside[inside] / (1.365 / 1.333)) ** 2))
    np.testing.assert_allclose(passed, expected, atol=0.02)


def test_specks_scratches_and_seam_are_painted_where_they_are() -> None:
    places = dirt.OuterDirt(specks=np.array([[1.0, -50.0, 0.5]]), scratches=np.array([[6.2, -20.0, 6.4, -20.0]]))
    opacity = dirt.outer_opacity(places, seam_rad=3.0, seam_opacity=0.3, radius_mm=76.2, z_range_mm=(-100.0, 0.0), mm_per_texel=0.1)
    columns = opacity.shape[1]
    assert opacity[500, round(1.0 / (2.0 * np.pi) * columns)] == 1.0
    assert np.count_nonzero(opacity == 1.0) * 0.01 == pytest.approx(np.pi * 0.25, rel=0.2)
    assert opacity[10, round(3.0 / (2.0 * np.pi) * columns)] == pytest.approx(0.3)
    assert opacity[198:203, 20].max() == pytest.approx(0.5, abs=0.15)  # beyond a whole turn it goes on at the beginning
    assert opacity[198:203, columns - 20].max() == pytest.approx(0.5, abs=0.15)


def test_a_camera_bends_light_by_its_curve_in_steps_of_its_files_and_loses_it_in_corners() -> None:
    light = np.full((40, 60), 0.2, np.float32)
    stored = expose(light, Camera(image_wh=(60, 40)), Disturbances(transfer="srgb", stored_bits=8), rng=np.random.default_rng(0))
    assert stored.dtype == np.uint8
    assert np.all(stored == round(255 * float(transfer.SRGB.number(np.array(0.2)))))
    vignetted = expose(np.full((30, 40), 0.8, np.float32), Camera(bits=16), Disturbances(vignetting=0.25), rng=np.random.default_rng(0))
    assert vignetted[0, 0] / 65535.0 == pytest.approx(0.6, abs=1e-3)
    assert vignetted[15, 20] / 65535.0 == pytest.approx(0.8, abs=2e-3)


def test_exposure_and_white_balance_wander_within_their_limits() -> None:
    light = np.full((8, 8), 0.5, np.float32)
    wrong = Disturbances(exposure_wander=0.1, white_balance_wander=0.03)
    found = np.array([expose(light, Camera(bits=16), wrong, rng=np.random.default_rng(k))[0, 0] for k in range(300)]) / 65535.0
    green = found[:, 1] / 0.5
    assert 0.9 <= green.min() < 0.91 < 1.09 < green.max() <= 1.1
    for colour in (0, 2):
        ratio = found[:, colour] / found[:, 1]
        assert 0.969 <= ratio.min() < 0.975 < 1.025 < ratio.max() <= 1.031


def test_the_reconstruction_knows_the_curve_and_nothing_else() -> None:
    wrong = Disturbances(transfer="srgb", stored_bits=8, wall_error=0.1, canister_radius_error_mm=0.3)
    given = scene_for_reconstruction(replace(SMALL, disturbances=wrong))
    assert (given.camera.transfer, given.camera.bits) == ("srgb", 8)
    assert given.canister == SMALL.canister
