"""Clicks into the 3D view: what they select, measure and cut."""

import numpy as np
import pytest

from rhizotwin.viewer import picking
from rhizotwin.viewer.app import Viewer
from rhizotwin.viewer.look import CLICKS
from tests.rhizotwin import plant as plants


def ray_to(point: np.ndarray) -> picking.Ray:
    eye = np.array([300.0, -200.0, 20.0])
    return picking.Ray(eye, (point - eye) / np.linalg.norm(point - eye))


def test_a_click_finds_the_root_it_meets_first(viewer: Viewer, plant: plants.Plant):
    found = []
    for root in plant.roots:
        viewer.clicked(ray_to(root.points_mm[30]))
        found += viewer.roots
    assert found == [0, 1, 2, 3]
    viewer.clicked(ray_to(np.array([60.0, 60.0, -100.0])))
    assert viewer.roots == []
    viewer.enter_picture(2)  # hides the 3D view
    assert viewer.picture == 2
    view, point = viewer.shown.pictures.views[2], plant.roots[3].points_mm[20]
    for off_px, expected in ((1.0, [3]), (-60.0, [])):  # through the water, in which the straight ray to the root does not lead
        px = viewer.shown.pictures.pixels(2, point[None])[0] + [0.0, off_px]
        toward = np.append((px - view.camera.principal_px) / view.camera.focal_px, 1.0) @ view.cam_from_canister[:3, :3]
        viewer.clicked(picking.Ray(view.centre_mm, toward / np.linalg.norm(toward)))
        assert viewer.roots == expected
    viewer.enter_picture(None)
    assert viewer.picture is None
    viewer.look.layers |= {"tubes"}
    for there in (False, True):  # a lateral that begins beside its parent is linked with it
        viewer.refresh()
        assert ("/roots/links" in viewer.scene) == there
        viewer.correct("parent", roots=[3, 1])


def test_clicks_measure_cut_and_end(viewer: Viewer, plant: plants.Plant):
    a, b = plant.roots[1].points_mm[30], plant.roots[2].points_mm[30]
    viewer.look.click = CLICKS[2]
    viewer.clicked(ray_to(a))
    viewer.clicked(ray_to(b))
    assert np.linalg.norm(viewer.measured[0] - viewer.measured[1]) == pytest.approx(np.linalg.norm(a - b), abs=1.0)
    viewer.look.click = CLICKS[3]
    viewer.clicked(ray_to(plant.roots[0].points_mm[15]))
    assert len(viewer.shown.session.state.lines) == 5
    viewer.look.click = CLICKS[4]
    viewer.clicked(ray_to(a))
    way = np.linalg.norm(np.diff(plant.roots[1].points_mm, axis=0), axis=1).sum()
    assert viewer.shown.session.state.lines[1].length_mm < 0.9 * way


def test_a_click_finds_the_voxel_that_its_ray_enters_first():
    centre = np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [2.0, 5.0, 0.0]])
    half = np.full(3, 0.5)
    hit = picking.voxel_at(centre, half, picking.Ray(np.array([10.0, 0.4, 0.0]), np.array([-1.0, 0.0, 0.0])))
    assert hit == (1, pytest.approx([2.5, 0.4, 0.0]))
    assert picking.voxel_at(centre, half, picking.Ray(np.array([10.0, 0.6, 0.0]), np.array([-1.0, 0.0, 0.0]))) is None


def test_what_is_clipped_cannot_be_clicked_and_has_two_sides(viewer: Viewer, plant: plants.Plant):
    point = plant.roots[1].points_mm[30]
    viewer.clip(2, None, float(point[2]) - 2.0)
    viewer.clicked(ray_to(point))
    assert viewer.roots != [1]
    viewer.clip(2, None, None)
    viewer.clicked(ray_to(point))
    assert viewer.roots == [1]
    viewer.look.low_mm, viewer.look.high_mm = (-1e9, -1e9, float(point[2]) - 1.0), (1e9, 1e9, float(point[2]) + 1.0)
    parts = viewer.visible()[1]
    assert 0.0 < sum(part.length_mm for part in parts) < viewer.shown.session.state.lines[1].length_mm
    surface = viewer._clip_mesh(viewer.shown.surface())
    assert surface is not None
    shown = np.concatenate([*(part.points_mm for part in parts), surface.vertices_mm])
    assert np.abs(shown[:, 2] - point[2]).max() <= 1.0
