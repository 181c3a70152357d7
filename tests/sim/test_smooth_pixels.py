"""Pixels told by their corners against all rays in every pixel."""

from dataclasses import replace

import numpy as np
import pytest

import rhizotwin.sim.render
from rhizotwin.scenes.disturbances import Disturbances
from rhizotwin.scenes.files import load_profile
from rhizotwin.scenes.model import Camera, CapturePlan, Ring, Scene
from rhizotwin.scenes.rsml import Root
from rhizotwin.sim.render import Renderer
from rhizotwin.sim.solids import to_surface, unite_roots
from rhizotwin.sim.specimen import SpecimenSolid
from rhizotwin.sim.world import draw_world


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


@pytest.mark.parametrize("profile", ["clean", "harsh"])
def test_smooth_pixels_are_what_all_rays_give(profile: str, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = Scene(plan=CapturePlan(rings=(Ring(views=2),)), disturbances=load_profile(profile))
    scene = replace(scene, camera=scene.camera.resized((200, 150)))
    renderer = Renderer(scene, draw_world(scene, seed=1), threads())
    light, coverage = renderer.view(1)
    assert 0.2 < (coverage[coverage > 0.0] < 0.5).mean() < 0.9, "threads and the thick root are both seen"
    monkeypatch.setattr(rhizotwin.sim.render, "MOST_BEND", -1.0)  # no pixel is smooth
    all_light, all_coverage = renderer.view(1)
    np.testing.assert_array_equal(coverage, all_coverage)
    assert 0.0 < np.abs(light - all_light).max() < 2e-4


def test_out_of_focus_edges_of_a_telecentric_camera_are_refined(monkeypatch: pytest.MonkeyPatch) -> None:
    """The focal lengths of the camera are not used: they would make the blur narrower."""
    camera = Camera(kind="telecentric", mm_per_px=0.05, image_wh=(640, 40), focal_px=(150.0, 150.0), principal_px=(319.5, 19.5))
    scene = Scene(camera=camera, plan=CapturePlan(rings=(Ring(views=1, height_mm=-60.0),)), disturbances=Disturbances(aperture_mm=20.0))
    renderer = Renderer(scene, draw_world(scene, seed=1), threads())
    _, coverage = renderer.view(0)
    monkeypatch.setattr(rhizotwin.sim.render, "MOST_BEND", -1.0)  # no pixel is smooth
    np.testing.assert_array_equal(coverage, renderer.view(0)[1])
