"""Attenuating media and dirt in the backlit fidelity."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from rhizotwin.scenes.disturbances import Disturbances
from rhizotwin.scenes.model import Camera, CapturePlan, Ring, Scene
from rhizotwin.scenes.rsml import Root
from rhizotwin.sim import solids
from rhizotwin.sim.dirt import Bubble, Fibre, Patch
from rhizotwin.sim.render import Image, Renderer
from rhizotwin.sim.specimen import SpecimenSolid
from rhizotwin.sim.world import World, draw_world

CENTRE = np.s_[14:16, 19:21]


def scene_with(wrong: Disturbances) -> Scene:
    scene = Scene(plan=CapturePlan(rings=(Ring(views=1, height_mm=-60.0),)), disturbances=wrong)
    return replace(scene, camera=scene.camera.resized((40, 30)))


def box(thickness_mm: float) -> SpecimenSolid:
    mesh = trimesh.creation.box((thickness_mm, 20.0, 20.0))
    vertices = np.asarray(mesh.vertices) + np.array([0.0, 0.0, -60.0])
    return SpecimenSolid(vertices=vertices, faces=np.asarray(mesh.faces, dtype=np.int32), volume_mm3=float(mesh.volume))


def centre_light(wrong: Disturbances, solid: SpecimenSolid | None = None, **changed: object) -> tuple[float, Image]:
    scene = scene_with(wrong)
    world: World = replace(draw_world(scene, seed=0), **changed)
    image, coverage = Renderer(scene, world, solid).view(0)
    return float(image[CENTRE].mean()), coverage


@pytest.fixture(scope="module")
def clear() -> float:
    """Return the light through clean water."""
    return centre_light(Disturbances())[0]


def test_turbid_water_and_a_root_in_it_weaken_light_by_beer_and_lambert(clear: float) -> None:
    turbid = centre_light(Disturbances(turbidity_per_mm=0.004))[0]
    assert turbid / clear == pytest.approx(np.exp(-0.004 * 2.0 * (76.2 - 3.175)), rel=2e-3)
    for free, wrong in ((clear, Disturbances(root_mu_per_mm=0.3)), (turbid, Disturbances(root_mu_per_mm=0.3, turbidity_per_mm=0.004))):
        behind, coverage = centre_light(wrong, box(4.0))
        assert behind / free == pytest.approx(np.exp(-(0.3 - wrong.turbidity_per_mm) * 4.0), rel=3e-3)
        np.testing.assert_array_equal(coverage[CENTRE], 1.0)


def test_algae_cover_the_light_by_their_opacity(clear: float) -> None:
    patch = Patch(azimuth_rad=0.0, z_mm=-60.0, radius_mm=25.0, opacity=0.4, lobes_rad=())
    assert centre_light(Disturbances(), algae=(patch,))[0] / clear == pytest.approx(0.6, rel=2e-3)


def test_a_bubble_lets_through_what_fresnel_says_and_a_fibre_shades_but_neither_is_root(clear: float) -> None:
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
    scene = scene_with(Disturbances(root_hair_mm=0.5, root_hair_mu_per_mm=0.2, root_mu_per_mm=0.5))
    camera = Camera(kind="telecentric", mm_per_px=0.05, image_wh=(80, 160), principal_px=(39.5, 79.5))
    z = np.linspace(-40.0, -80.0, 41)
    root = Root(points_mm=np.stack([0.0 * z, 0.0 * z, z], axis=1), diameters_mm=np.full(41, 2.0), order=0, parent=-1)
    vertices, faces = solids.to_surface(solids.unite_roots([root]))
    solid = SpecimenSolid(vertices=vertices, faces=faces, volume_mm3=40.0 * np.pi, roots=(root,))
    scene = replace(scene, camera=camera)
    image, _ = Renderer(scene, draw_world(scene, seed=0), solid).view(0)
    assert np.abs(image / np.median(image, axis=0) - 1.0).max() < 0.02
