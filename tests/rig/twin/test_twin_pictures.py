"""The twin's pictures: the strip where the projection says, rendered as `sim` renders, only as the world is; and their truth."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from rhizotwin.recon.calibration.markers import detect_markers
from rhizotwin.rig.twin.rendered_pictures import RenderedPictures, draw
from rhizotwin.rig.twin.sketch import Sketch
from rhizotwin.rig.twin.twin import Twin
from rhizotwin.rig.twin.world import Sight
from rhizotwin.scenes import frames, plan
from rhizotwin.scenes.atomic import write_image
from rhizotwin.scenes.dataset import Frame
from rhizotwin.scenes.disturbances import Disturbances
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import CapturePlan, Ring, Scene
from rhizotwin.scenes.specimens import SphereSpecimen
from rhizotwin.scenes.truth import load_truth
from rhizotwin.sim.render import Renderer
from rhizotwin.sim.specimen import build_specimen
from rhizotwin.sim.world import TrueCamera, draw_world

pytestmark = pytest.mark.usefixtures("coarse_ball")
WRONG = Disturbances(
    distortion=(-0.05, 0.02, 0.0003, -0.0002, 0.0),
    canister_offset_mm=1.0,
    canister_tilt_deg=0.5,
    strip_offset_mm=0.2,
    strip_tilt_deg=0.1,
    arm_deg=0.3,
    arm_mm=1.5,
    table_deg=0.05,
    backlight_unevenness=0.3,
)
RINGS = (Ring(views=3, first_deg=17.0), Ring(views=2, height_mm=30.0, tilt_deg=12.0, distance_mm=380.0))


def scene_of(image_wh: tuple[int, int], wrong: Disturbances = WRONG) -> Scene:
    scene = Scene(name="tiny", specimen=SphereSpecimen(diameter_mm=30.0), disturbances=wrong, plan=CapturePlan(rings=RINGS))
    return replace(scene, camera=scene.camera.resized(image_wh))


def sight_of(scene: Scene, k: int, *, seed: int = 0) -> Sight:
    """Return what the camera of view k of the simulator sees."""
    seen = draw_world(scene, seed=seed).cameras[k]
    poses = {"cam_from_rig": seen.cam_from_rig, "rig_from_canister": seen.rig_from_canister}
    return Sight(**poses, table_deg=seen.table_deg, panel=1.0, front=1.0)


def test_the_strip_is_drawn_where_it_is_projected() -> None:
    scene, drawn = scene_of((800, 600)), draw(scene_of((800, 600)), seed=0)
    sight, corners_of = sight_of(scene, 4), plan.marker_corners(scene.strip, scene.net_pot)
    sketch = Sketch(scene, distortion=drawn.distortion, canister_from_strip=drawn.canister_from_strip)
    markers = detect_markers(sketch.picture(sight), scene.strip)
    found = dict(zip(markers.ids.tolist(), markers.corners_px, strict=True))
    cam_from_strip = sight.cam_from_rig @ sight.rig_from_canister @ drawn.canister_from_strip
    assert len(found) >= 8
    off_px = np.concatenate([corners - _project(scene, cam_from_strip, corners_of[number]) for number, corners in found.items()])
    assert np.abs(off_px).max() < 0.25
    assert np.abs(off_px.mean(axis=0)).max() < 0.03


def _project(scene: Scene, cam_from_strip: frames.Array, points: frames.Array) -> NDArray[np.float64]:
    (fx, fy), (cx, cy) = scene.camera.focal_px, scene.camera.principal_px
    matrix = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    pixels, _ = cv2.projectPoints(frames.apply(cam_from_strip, points), np.zeros(3), np.zeros(3), matrix, np.array(WRONG.distortion))
    return np.asarray(pixels).reshape(-1, 2)


TINY = scene_of((64, 48), replace(WRONG, full_well_e=8000.0, read_noise_e=3.0))


@pytest.fixture(scope="module")
def rendered() -> RenderedPictures:
    return RenderedPictures(TINY, seed=3, samples=4)


def test_a_rendered_picture_is_that_of_sim(rendered: RenderedPictures) -> None:
    image, _ = Renderer(TINY, draw_world(TINY, seed=3), build_specimen(TINY), samples=4).view(4)
    np.testing.assert_array_equal(rendered.light(sight_of(TINY, 4, seed=3)), image)
    assert image.max() > 0.4


def test_lamps_add_up_and_noise_belongs_to_the_state(rendered: RenderedPictures) -> None:
    full = sight_of(TINY, 0, seed=3)
    both, panel, mixed = (rendered.light(replace(full, front=front)) for front in (1.0, 0.0, 0.5))
    np.testing.assert_allclose(mixed, (both + panel) / 2.0, atol=1e-6)
    assert rendered.light(replace(full, panel=0.0, front=0.0)).max() == 0.0
    one, other = rendered.picture(full), rendered.picture(replace(full, table_deg=full.table_deg, front=0.999999))
    np.testing.assert_array_equal(one, RenderedPictures(TINY, seed=3, samples=4).picture(full))
    assert (one != other).mean() > 0.2
    assert rendered.picture(replace(full, exposure=1.2)).mean() == pytest.approx(1.2 * one.mean(), rel=0.01)


def test_a_scan_with_the_twin_has_a_truth(tmp_path: Path) -> None:
    twin = Twin(TINY, seed=3, profile_name="bench", samples=4)
    twin.record.keep_in(tmp_path / "record.jsonl")
    for lamp in (twin.world.panel, twin.world.front):
        lamp.show((255, 255, 255))
    camera, made = twin.open_camera(), []
    for k in range(2):
        twin.world.table.queue(60.0 * k, 30.0)
        twin.clock.sleep(20.0)
        write_image(tmp_path / "images" / f"view_{k:03d}.png", camera.capture().image)
        made.append((Frame(file=f"images/view_{k:03d}.png", sha256=""), twin.world.table_deg, twin.world.cam_from_rig))
    twin.write_truth(tmp_path, [frame for frame, _, _ in made])
    truth = load_truth(tmp_path)
    assert truth.volume_mm3 == pytest.approx(np.pi / 6.0 * 30.0**3, rel=1e-3)
    world = draw_world(TINY, seed=3)
    np.testing.assert_allclose(truth.canister_from_strip, world.canister_from_strip)
    assert [(view.file, view.table_deg) for view in truth.views] == [(frame.file, table_deg) for frame, table_deg, _ in made]
    wanted = [pose @ plan.rig_from_table(TINY, table_deg) @ world.table_from_canister for _, table_deg, pose in made]
    np.testing.assert_allclose([view.cam_from_canister for view in truth.views], wanted, atol=1e-9)
    seen = twin.record.shots[1].sight
    sight = TrueCamera(cam_from_rig=seen.cam_from_rig, rig_from_canister=seen.rig_from_canister, table_deg=seen.table_deg)
    _, coverage = Renderer(TINY, world, build_specimen(TINY), samples=4).look(sight, ring=0)
    mask = cv2.imread(str(tmp_path / "truth" / "masks" / "view_001.png"), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(mask, np.rint(coverage * 65535.0))
    later = Twin(TINY, seed=3, profile_name="bench", samples=4)
    with pytest.raises(UserError, match="not taken by this emulated rig"):
        later.write_truth(tmp_path, [made[0][0]])
    later.record.keep_in(tmp_path / "record.jsonl")
    later.write_truth(tmp_path, [made[1][0]])
    assert load_truth(tmp_path).views == truth.views[1:]


def test_the_twin_stands_as_the_simulator_draws_it() -> None:
    scene = scene_of((64, 48))
    twin, world = Twin(scene, seed=5, profile_name="bench", pictures="sketch"), draw_world(scene, seed=5)
    np.testing.assert_array_equal(twin.world.table_from_canister, world.table_from_canister)
    known = twin.calibrated_scene()
    assert (known.specimen, known.disturbances, known.camera.distortion) == (None, Disturbances(), WRONG.distortion)
    tripod = Twin(scene, seed=5, pictures="sketch", rig=replace(twin.rig, arm=None))
    np.testing.assert_array_equal(tripod.world.cam_from_rig, world.cameras[0].cam_from_rig)
