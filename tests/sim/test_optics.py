"""The rendered canister and tank against Snell's and Fresnel's laws traced separately, and pixels told by corners against all rays."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray
from scipy.optimize import brentq, least_squares

import rhizotwin.sim.render
from rhizotwin.recon.optics.cameras import View, project_inner
from rhizotwin.recon.optics.refraction import Optics
from rhizotwin.scenes import frames, plan
from rhizotwin.scenes.checks import check_scene
from rhizotwin.scenes.disturbances import Disturbances
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.files import load_profile
from rhizotwin.scenes.model import Camera, Canister, CapturePlan, Lights, NetPot, Ring, Scene, Tank
from rhizotwin.scenes.rsml import Root
from rhizotwin.sim.backlit import AMBIENT
from rhizotwin.sim.optics import ROOT_REFLECTANCE
from rhizotwin.sim.render import Renderer, check_samples
from rhizotwin.sim.solids import to_surface, unite_roots
from rhizotwin.sim.specimen import SpecimenSolid
from rhizotwin.sim.world import draw_world
from tests.system import snell

Array = NDArray[np.float64]
MISPLACED = Disturbances(arm_deg=0.3, arm_mm=1.0, table_deg=0.1, canister_offset_mm=1.0, canister_tilt_deg=0.5)


def ball(centre_mm: tuple[float, float, float], radius_mm: float) -> SpecimenSolid:
    mesh = trimesh.creation.icosphere(4, radius_mm)
    vertices = np.asarray(mesh.vertices) + centre_mm
    return SpecimenSolid(vertices=vertices, faces=np.asarray(mesh.faces, dtype=np.int32), volume_mm3=float(mesh.volume))


def magnify(scene: Scene, pixel: Array, times: float, size: int) -> Scene:
    """Put the same lens before a sensor of ``size`` x ``size`` pixels, ``times`` smaller, centred on a pixel."""
    fx, fy = scene.camera.focal_px
    cx, cy = (np.array(scene.camera.principal_px) - pixel) * times + (size - 1) / 2.0
    camera = replace(scene.camera, image_wh=(size, size), focal_px=(fx * times, fy * times), principal_px=(cx, cy))
    return replace(scene, camera=camera)


def centroid(coverage: NDArray[np.float32]) -> Array:
    y, x = np.mgrid[: coverage.shape[0], : coverage.shape[1]]
    return np.array([np.sum(x * coverage), np.sum(y * coverage)], dtype=float) / np.sum(coverage)


def ray_in_water(scene: Scene, n_water: float, cam_from_canister: Array, pixel: Array) -> tuple[Array, Array]:
    fx, fy = scene.camera.focal_px
    cx, cy = scene.camera.principal_px
    canister_from_cam = frames.invert(cam_from_canister)
    direction = canister_from_cam[:3, :3] @ np.array([(pixel[0] - cx) / fx, (pixel[1] - cy) / fy, 1.0])
    start, into, _, _ = snell.into_water(canister_from_cam[None, :3, 3], direction[None] / np.linalg.norm(direction), n_water=n_water)
    return start[0], into[0]


def check_place(scene: Scene, expected_px: Array, centre_mm: tuple[float, float, float], *, view: int, atol_px: float) -> None:
    part = magnify(scene, expected_px, 100.0, 160)
    _, coverage = Renderer(part, draw_world(part, seed=4), ball(centre_mm, 0.1), samples=4).view(view)
    assert coverage.max() == 1.0
    assert not coverage[0].any()
    np.testing.assert_allclose((centroid(coverage) - 79.5) / 100.0, 0.0, atol=atol_px)


def project_by_search(scene: Scene, n_water: float, cam_from_canister: Array, point: Array) -> Array:

    def miss(pixel: Array) -> Array:
        start, direction = ray_in_water(scene, n_water, cam_from_canister, pixel)
        away = point - start
        return away - (away @ direction) * direction

    in_cam = frames.apply(cam_from_canister, point)
    start = np.array(scene.camera.focal_px) * in_cam[:2] / in_cam[2] + np.array(scene.camera.principal_px)
    return np.asarray(least_squares(miss, start, xtol=1e-14, ftol=1e-14, gtol=1e-14).x)


CASES = {
    "near the axis": ((3.0, 2.0, -60.0), 0, Ring(views=5), Disturbances()),
    "raised and tilted camera": ((10.0, 30.0, -80.0), 0, Ring(views=5, height_mm=150.0, tilt_deg=25.0), Disturbances()),
    "everything misplaced": ((20.0, -30.0, -70.0), 2, Ring(views=5), replace(MISPLACED, n_water_error=0.001)),
}


@pytest.mark.parametrize(("centre_mm", "view", "ring", "wrong"), CASES.values(), ids=CASES)
def test_a_ball_in_the_water_is_seen_where_snell_says(
    centre_mm: tuple[float, float, float], view: int, ring: Ring, wrong: Disturbances
) -> None:
    scene = Scene(plan=CapturePlan(rings=(ring,)), disturbances=wrong)
    world = draw_world(scene, seed=4)
    expected = project_by_search(scene, world.n_water, world.cameras[view].cam_from_canister, np.array(centre_mm))
    check_place(scene, expected, centre_mm, view=view, atol_px=1e-3)


def test_an_empty_canister_is_symmetric_and_obeys_fresnel() -> None:
    scene = Scene(camera=Camera().resized((80, 60)), plan=CapturePlan(rings=(Ring(views=1),)))
    image, coverage = Renderer(scene, draw_world(scene, seed=0), None).view(0)
    can, level = scene.canister, scene.lights.backlight_level
    faces = [1.0 - ((can.n_wall - n) / (can.n_wall + n)) ** 2 for n in (1.0, scene.water.n_water)]  # Fresnel, normal incidence
    np.testing.assert_allclose(image[30, 39:41], level * np.prod(faces) ** 2, rtol=2e-3)
    np.testing.assert_allclose(image[30, 1], level, rtol=1e-5)
    assert not coverage.any()
    np.testing.assert_allclose(image[24:], image[24:, ::-1], atol=2e-3)  # below the strip


def test_both_fidelities_agree_on_light_and_mask() -> None:
    scene = Scene(camera=Camera().resized((80, 60)), plan=CapturePlan(rings=(Ring(views=2),)))
    world = draw_world(scene, seed=3)
    solid = ball((5.0, 10.0, -55.0), 12.0)
    fast, mask = Renderer(scene, world, solid).view(1)
    full, same_mask = Renderer(scene, world, solid, fidelity="path", samples=64).view(1)
    np.testing.assert_array_equal(mask, same_mask)
    through = np.s_[25:55, 30:50]
    free = mask[through] == 0.0
    assert np.mean(full[through][free]) == pytest.approx(np.mean(fast[through][free]), rel=0.06)
    assert np.mean(full[mask == 1.0]) < 0.1 * scene.lights.backlight_level
    assert np.mean(fast[mask == 1.0]) < 0.1 * scene.lights.backlight_level
    np.testing.assert_allclose(full[:, 2], fast[:, 2], rtol=1e-3)


def test_a_printed_corner_is_where_the_plan_says() -> None:
    scene = Scene(plan=CapturePlan(rings=(Ring(views=1),)))
    camera, cam_from_canister = scene.camera, draw_world(scene, seed=0).cameras[0].cam_from_canister
    for marker_id in (0, 31):
        in_cam = frames.apply(cam_from_canister, plan.marker_corners(scene.strip, scene.net_pot)[marker_id])
        for corner, black in ((0, np.s_[20:, 20:]), (2, np.s_[:21, :21])):  # the marker lies below and right of its top left corner
            pixel = np.array(camera.focal_px) * in_cam[corner, :2] / in_cam[corner, 2] + np.array(camera.principal_px)
            part = magnify(scene, pixel, 10.0, 41)
            image, _ = Renderer(part, draw_world(part, seed=0), None, samples=4).view(0)
            dark = 1.0 - (image - image.min()) / np.ptp(image)
            rows, columns = black
            edge_x = dark[rows][5:-5].mean(axis=0).sum() - 20.5
            edge_y = dark[:, columns][:, 5:-5].mean(axis=1).sum() - 20.5
            np.testing.assert_allclose([edge_x / 10.0, edge_y / 10.0], 0.0, atol=0.04)


@pytest.mark.parametrize(("fidelity", "samples"), [("backlit", 4), ("path", 64)])
def test_white_paper_facing_the_camera_reaches_its_level(fidelity: str, samples: int) -> None:
    plan_of_one, pot = CapturePlan(rings=(Ring(views=1),)), replace(NetPot(), skirt_bottom_mm=-5.0)
    scene = Scene(camera=Camera().resized((100, 75)), plan=plan_of_one, net_pot=pot)
    image, _ = Renderer(scene, draw_world(scene, seed=0), None, fidelity=fidelity, samples=samples).view(0)
    assert np.quantile(image[3:19, 43:57], 0.9) == pytest.approx(scene.lights.front_level, rel=0.15)


def threads() -> SpecimenSolid:
    """Return upright and level threads of a third of a pixel, which corners miss over long stretches, and a thick root."""
    roots = []
    for x_mm, y_mm, diameter_mm in ((3.0, -20.0, 0.3), (-30.0, 7.0, 0.3), (10.0, 12.0, 6.0)):
        points = np.array([[x_mm, y_mm, -20.0], [x_mm, y_mm, -100.0]])
        roots.append(Root(points_mm=points, diameters_mm=np.full(2, diameter_mm), order=0, parent=-1))
    level = np.array([[5.0, -30.0, -60.3], [5.0, 30.0, -60.3]])
    roots.append(Root(points_mm=level, diameters_mm=np.full(2, 0.3), order=0, parent=-1))
    solid = unite_roots(roots)
    vertices, faces = to_surface(solid)
    return SpecimenSolid(vertices=vertices, faces=faces, volume_mm3=solid.volume())


@pytest.mark.parametrize("profile", ["harsh", "clean"])
def test_smooth_pixels_are_what_all_rays_give(profile: str, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = Scene(camera=Camera().resized((200, 150)), plan=CapturePlan(rings=(Ring(views=2),)), disturbances=load_profile(profile))
    renderer = Renderer(scene, draw_world(scene, seed=1), threads())
    light, coverage = renderer.view(1)
    assert 0.2 < (coverage[coverage > 0.0] < 0.5).mean() < 0.9, "threads and the thick root are both seen"
    monkeypatch.setattr(rhizotwin.sim.render, "MOST_BEND", -1.0)  # no pixel is smooth
    all_light, all_coverage = renderer.view(1)
    np.testing.assert_array_equal(coverage, all_coverage)
    assert 0.0 < np.abs(light - all_light).max() < 2e-4
    assert (renderer.backlit.wall is None) == (profile == "harsh")
    renderer.backlit.wall = None  # also the rays through the clear wall are traced by Mitsuba
    traced_light, traced_coverage = renderer.view(1)
    same = traced_coverage == all_coverage
    assert np.count_nonzero(~same) <= 2, "only rays that graze a root may miss it by rounding"
    np.testing.assert_allclose(traced_light[same], all_light[same], atol=2e-4)


TANKS = {
    "beside, in another liquid": ((0.0, 66.0, -80.0), 0, Tank(n_liquid=1.38), Disturbances()),
    "a turned tank": ((-20.0, 45.0, -90.0), 0, Tank(turn_deg=3.0), Disturbances()),
    "everything misplaced": ((20.0, -60.0, -70.0), 2, Tank(), MISPLACED),
}


@pytest.mark.parametrize(("centre_mm", "number", "tank", "wrong"), TANKS.values(), ids=TANKS)
def test_a_ball_is_seen_where_the_closed_form_says(
    centre_mm: tuple[float, float, float], number: int, tank: Tank, wrong: Disturbances
) -> None:
    scene = Scene(plan=CapturePlan(rings=(Ring(views=5),)), tank=tank, disturbances=wrong)
    camera = draw_world(scene, seed=4).cameras[number]
    cam_from_tank = camera.cam_from_canister @ frames.invert(camera.rig_from_canister) @ frames.rotation_z(np.deg2rad(tank.turn_deg))
    view = View(camera=scene.camera, cam_from_canister=camera.cam_from_canister, cam_from_tank=cam_from_tank)
    expected = project_inner(view, Optics.from_scene(scene), np.array([centre_mm]))
    check_place(scene, expected[0], centre_mm, view=number, atol_px=2e-3)


def test_the_empty_tank_passes_the_panel_and_keeps_the_strip_dry() -> None:
    scene = replace(Scene(tank=Tank(), plan=CapturePlan(rings=(Ring(views=1),))), camera=Scene().camera.resized((100, 75)))
    light, coverage = Renderer(scene, draw_world(scene, seed=0), None, samples=4).view(0)
    open_air = replace(scene, tank=None)
    bare, _ = Renderer(open_air, draw_world(open_air, seed=0), None, samples=4).view(0)
    assert not coverage.any()
    glass, wet = (1.0 - ((1.49 - n) / (1.49 + n)) ** 2 for n in (1.0, 1.333))  # Fresnel, normal incidence
    # through two walls of the tank, air and liquid, and twice through the canister's, liquid and water
    assert light[37, 49:51].mean() == pytest.approx(scene.lights.backlight_level * glass**2 * wet**6, rel=2e-3)
    assert np.abs(light[:16] - bare[:16]).max() < 1e-3  # above the liquid nothing is changed


def test_plane_walls_refract_and_side_lights_show_roots() -> None:
    box = Canister(outer_radius_mm=54.0, half_width_mm=56.0, wall_mm=3.0, n_wall=1.52)
    lights = Lights(backlight_level=0.0, side_level=0.8)
    scene = Scene(canister=box, lights=lights, plan=CapturePlan(rings=(Ring(views=1),)))
    centre = np.array([5.0, 20.0, -60.0])
    world = draw_world(scene, seed=4)
    camera_mm = frames.invert(world.cameras[0].cam_from_canister)[:3, 3]
    aside = centre[1:] - camera_mm[1:]
    paths_mm = {1.0: camera_mm[0] - 54.0, 1.52: 3.0, world.n_water: 54.0 - 3.0 - centre[0]}

    def miss_mm(sine: float) -> float:
        return sum(length * sine / np.sqrt(n**2 - sine**2) for n, length in paths_mm.items()) - float(np.linalg.norm(aside))

    sine = brentq(miss_mm, 0.0, 0.5)
    across, up = sine / np.sqrt(1.0 - sine**2) * aside / np.linalg.norm(aside)
    expected = np.array(scene.camera.principal_px) + scene.camera.focal_px[0] * np.array([across, -up])
    check_place(scene, expected, (5.0, 20.0, -60.0), view=0, atol_px=0.01)
    part = magnify(scene, expected, 20.0, 100)
    image, coverage = Renderer(part, draw_world(part, seed=4), ball((5.0, 20.0, -60.0), 0.3), samples=4).view(0)
    assert image[coverage == 0.0].max() == 0.0
    assert image.max() == pytest.approx(ROOT_REFLECTANCE * (AMBIENT / world.n_water**2 + 0.8), rel=0.1)
    assert image[50, 50] < 0.5 * image.max()  # the front of a ball faces neither lamp
    with pytest.raises(UserError, match="no side lights"):
        check_samples(part, "path", None)


BOXES = {
    "not the shorter side": ({"half_width_mm": 50.0}, "must be at least outer_radius_mm, 54"),
    "corners outside the pot": ({"half_width_mm": 70.0}, r"must be below 58\.48"),
}


@pytest.mark.parametrize(("change", "said"), BOXES.values(), ids=BOXES)
def test_rectangles_that_do_not_fit_are_refused(change: dict[str, float], said: str) -> None:
    with pytest.raises(UserError, match=said):
        check_scene(Scene(canister=replace(Canister(outer_radius_mm=54.0), **change)))
