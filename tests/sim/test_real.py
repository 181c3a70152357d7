"""What a real scan adds to the twin, against closed forms: media, walls, sway, hairs, refracting roots, dirt, the camera."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import trimesh

from rhizotwin.scenes import transfer
from rhizotwin.scenes.disturbances import Disturbances
from rhizotwin.scenes.model import Camera, CapturePlan, Ring, Scene
from rhizotwin.scenes.rsml import Root
from rhizotwin.scenes.specimens import SphereSpecimen
from rhizotwin.sim import dirt, solids
from rhizotwin.sim.dirt import Bubble, Fibre, Patch
from rhizotwin.sim.exposure import expose
from rhizotwin.sim.render import Image, Renderer
from rhizotwin.sim.specimen import SpecimenSolid, build_specimen
from rhizotwin.sim.world import World, draw_world, scene_for_reconstruction

pytestmark = pytest.mark.usefixtures("coarse_ball")
BALL = SphereSpecimen(diameter_mm=20.0, centre_mm=(0.0, 0.0, -60.0))
SMALL = Scene(camera=Scene().camera.resized((160, 120)), plan=CapturePlan(rings=(Ring(views=4),)), specimen=BALL)


@cache
def picture(wrong: Disturbances, *, view: int = 0, empty: bool = False) -> tuple[np.ndarray, np.ndarray]:
    scene = replace(SMALL, disturbances=wrong)
    solid = None if empty else build_specimen(scene)
    return Renderer(scene, draw_world(scene, seed=1), solid).view(view)


def test_a_larger_canister_is_seen_wider_by_as_much() -> None:
    px_a_mm = SMALL.camera.focal_px[0] / np.sqrt(400.0**2 - 76.2**2)
    nominal, larger = (picture(Disturbances(canister_radius_error_mm=wrong), empty=True)[0][80] for wrong in (0.0, 2.0))
    first, then = (np.flatnonzero(row < 0.4) for row in (nominal, larger))
    assert np.ptp(then) - np.ptp(first) == pytest.approx(2.0 * 2.0 * px_a_mm, abs=1.5)


def test_a_swaying_ball_is_seen_where_it_hangs() -> None:
    wrong = Disturbances(sway_mm=2.0)
    sway = np.array(draw_world(replace(SMALL, disturbances=wrong), seed=1).sway_mm)
    seen = [picture(Disturbances())[1], picture(wrong, view=0)[1], picture(wrong, view=1)[1]]
    middle, *columns = (float((coverage.sum(axis=0) @ np.arange(160)) / coverage.sum()) for coverage in seen)
    px_a_mm = 1.333 * SMALL.camera.focal_px[0] / 400.0  # a water cylinder enlarges what is at its axis by its index
    # views 0 and 1 look along -x and (the table turns counter-clockwise) +y of the canister; the ball's middle goes half the tip's way
    expected = np.abs(0.5 * np.array([sway[0, 1], sway[1, 0]]) * px_a_mm)
    assert np.abs(np.array(columns) - middle) == pytest.approx(expected, abs=0.12)


def test_a_glassy_ball_takes_light_by_chords_of_refracted_rays() -> None:
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
    assert opacity[198:203, [20, -20]].max(axis=0) == pytest.approx(0.5, abs=0.15)  # beyond a whole turn it goes on at the beginning


def test_a_camera_has_a_curve_steps_and_dark_corners() -> None:
    light = np.full((40, 60), 0.2, np.float32)
    stored = expose(light, Camera(image_wh=(60, 40)), Disturbances(transfer="srgb", stored_bits=8), rng=np.random.default_rng(0))
    assert stored.dtype == np.uint8
    assert np.all(stored == round(255 * float(transfer.SRGB.number(np.array(0.2)))))
    vignetted = expose(np.full((30, 40), 0.8, np.float32), Camera(bits=16), Disturbances(vignetting=0.25), rng=np.random.default_rng(0))
    assert vignetted[0, 0] / 65535.0 == pytest.approx(0.6, abs=1e-3)
    assert vignetted[15, 20] / 65535.0 == pytest.approx(0.8, abs=2e-3)


def test_the_reconstruction_knows_the_curve_and_nothing_else() -> None:
    wrong = Disturbances(transfer="srgb", stored_bits=8, wall_error=0.1, canister_radius_error_mm=0.3)
    given = scene_for_reconstruction(replace(SMALL, disturbances=wrong))
    assert (given.camera.transfer, given.camera.bits) == ("srgb", 8)
    assert given.canister == SMALL.canister


CENTRE = np.s_[14:16, 19:21]
SMALLER = replace(SMALL, camera=Scene().camera.resized((40, 30)), plan=CapturePlan(rings=(Ring(views=1, height_mm=-60.0),)), specimen=None)


def centre_light(wrong: Disturbances, solid: SpecimenSolid | None = None, **changed: object) -> tuple[float, Image]:
    scene = replace(SMALLER, disturbances=wrong)
    world: World = replace(draw_world(scene, seed=0), **changed)
    image, coverage = Renderer(scene, world, solid).view(0)
    return float(image[CENTRE].mean()), coverage


@pytest.fixture(scope="module")
def clear() -> float:
    return centre_light(Disturbances())[0]


def test_turbid_water_and_roots_weaken_light_by_beer_and_lambert(clear: float) -> None:
    turbid = centre_light(Disturbances(turbidity_per_mm=0.004))[0]
    assert turbid / clear == pytest.approx(np.exp(-0.004 * 2.0 * (76.2 - 3.175)), rel=2e-3)
    mesh = trimesh.creation.box((4.0, 20.0, 20.0), transform=trimesh.transformations.translation_matrix((0.0, 0.0, -60.0)))
    plate = SpecimenSolid(vertices=np.asarray(mesh.vertices), faces=np.asarray(mesh.faces, dtype=np.int32), volume_mm3=1600.0)
    for free, wrong in ((clear, Disturbances(root_mu_per_mm=0.3)), (turbid, Disturbances(root_mu_per_mm=0.3, turbidity_per_mm=0.004))):
        behind, coverage = centre_light(wrong, plate)
        assert behind / free == pytest.approx(np.exp(-(0.3 - wrong.turbidity_per_mm) * 4.0), rel=3e-3)
        np.testing.assert_array_equal(coverage[CENTRE], 1.0)


def test_algae_cover_the_light_by_their_opacity(clear: float) -> None:
    patch = Patch(azimuth_rad=0.0, z_mm=-60.0, radius_mm=25.0, opacity=0.4, lobes_rad=())
    assert centre_light(Disturbances(), algae=(patch,))[0] / clear == pytest.approx(0.6, rel=2e-3)


def test_bubbles_pass_fresnel_s_share_fibres_shade_none_is_root(clear: float) -> None:
    bubble = Bubble(x_mm=0.0, y_mm=0.0, z_mm=-60.0, radius_mm=40.0)
    behind, coverage = centre_light(Disturbances(), bubbles=(bubble,))
    through_one_face = 1.0 - (0.333 / 2.333) ** 2
    assert behind / clear == pytest.approx(through_one_face**2, rel=2e-3)
    assert not coverage.any()
    fibre = Fibre(points_mm=np.array([[0.0, 0.0, -50.0], [0.0, 0.0, -60.0], [0.0, 0.0, -70.0]]), radius_mm=1.0)
    behind, coverage = centre_light(Disturbances(), fibres=(fibre,))
    assert behind < 0.9 * clear
    assert not coverage.any()


def test_parallel_rays_along_an_axis_miss_no_surface() -> None:
    """A hairy vertical root looks the same at every height."""
    hairs = Disturbances(root_hair_mm=0.5, root_hair_mu_per_mm=0.2, root_mu_per_mm=0.5)
    camera = Camera(kind="telecentric", mm_per_px=0.05, image_wh=(80, 160), principal_px=(39.5, 79.5))
    z = np.linspace(-40.0, -80.0, 41)
    root = Root(points_mm=np.stack([0.0 * z, 0.0 * z, z], axis=1), diameters_mm=np.full(41, 2.0), order=0, parent=-1)
    vertices, faces = solids.to_surface(solids.unite_roots([root]))
    solid = SpecimenSolid(vertices=vertices, faces=faces, volume_mm3=40.0 * np.pi, roots=(root,))
    scene = replace(SMALLER, camera=camera, disturbances=hairs)
    image, _ = Renderer(scene, draw_world(scene, seed=0), solid).view(0)
    assert np.abs(image / np.median(image, axis=0) - 1.0).max() < 0.02
