"""State of a running scan, the coarse hull of its roots, and the measurements of a picture."""

import cv2
import numpy as np
import pytest

from rhizotwin.console.hull import Hull
from rhizotwin.console.live import Live
from rhizotwin.console.pictures import show
from rhizotwin.recon.optics.cameras import View, project_inner
from rhizotwin.recon.optics.refraction import Optics
from rhizotwin.rig.scanning.markers import Sighting
from rhizotwin.rig.scanning.observer import Look
from rhizotwin.rig.scanning.preflight import Exposure
from rhizotwin.scenes import frames, plan
from rhizotwin.scenes.dataset import Frame, load_dataset, read_image
from rhizotwin.scenes.model import CapturePlan, Ring, Scene, Tank
from tests.rhizotwin import plant as plants


def look(number: int, image: np.ndarray, sighting: Sighting | None = None) -> Look:
    frame = Frame(file=f"images/view_{number:03d}.png", sha256="", table_deg=45.0 * number)
    return Look(frame=frame, image=image, exposure=Exposure(bright=0.8, saturated=0.0), sighting=sighting, motion=None)


def test_the_hull_holds_every_root_and_little_else(plant: plants.Plant):
    dataset = load_dataset(plant.dataset)
    hull = Hull(dataset.scene)
    assert hull.evenness(0) is None
    for frame in dataset.frames:
        hull.add(frame.file, 0, read_image(dataset, frame), np.array(frame.cam_from_canister))
    cells, edge_mm = hull.carve()
    points = np.concatenate([root.points_mm for root in plant.roots])
    away = np.abs(points[:, None] - cells[None]).max(axis=-1).min(axis=1)
    assert np.mean(away <= 0.5 * edge_mm + 1e-9) > 0.95
    far = np.linalg.norm(cells[:, None] - points[None], axis=-1).min(axis=1)
    assert far.max() < 10.0  # mm: eight views of 200 pixels leave a little round each root
    assert hull.evenness(0) == pytest.approx((230 / 255, 230 / 255))
    for frame in dataset.frames[:6]:
        hull.drop(frame.file)
    assert len(hull.carve()[0]) == 0  # two pictures give no shape


def test_the_hull_in_a_tank_holds_a_ball_near_the_wall():
    turn_deg = 20.0
    camera = Scene().camera.resized((400, 300))
    scene = Scene(camera=camera, tank=Tank(turn_deg=turn_deg), plan=CapturePlan(rings=(Ring(views=8),)))
    live, ball_mm = Live(scene), np.array([[0.0, 50.0, -80.0]])
    for number in range(8):
        rig_from_canister = plan.rig_from_table(scene, 45.0 * number)
        pose = plan.views(scene)[number].cam_from_rig @ rig_from_canister
        cam_from_tank = pose @ frames.invert(rig_from_canister) @ frames.rotation_z(np.deg2rad(turn_deg))
        view = View(camera=camera, cam_from_canister=pose, cam_from_tank=cam_from_tank)
        (at,) = project_inner(view, Optics.from_scene(scene), ball_mm)
        image = np.full((300, 400), 200, np.uint8)
        if np.isfinite(at).all():
            cv2.circle(image, np.round(at).astype(int).tolist(), 5, 20, -1)
        live.on_look(look(number, image, Sighting(cam_from_canister=pose, markers=9, reprojection_px=0.1)))
    live.close()
    assert live.panel == pytest.approx((200 / 255, 200 / 255))
    assert len(live.cells_mm)
    assert np.linalg.norm(live.cells_mm - ball_mm, axis=1).max() < 10.0


def test_an_error_of_the_console_does_not_reach_the_scan():
    live = Live(Scene(), on_change=lambda: 1 / 0)
    live.on_plan(3, 0)
    live.close()


def test_a_dark_picture_is_called_so():
    shown = show(np.full((300, 1000), 20, np.uint8), None, number=3, title="dark", panel=(0.1, 0.4), motion=0.02)
    found = {meter.name: meter.state for meter in shown.meters}
    assert (found["Exposure"], found["Panel"]) == ("bad", "fair")
