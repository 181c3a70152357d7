"""Edges of a canister drawn by brute force: each pixel knows how far its ray passes from the axis."""

from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest

from rhizotwin.recon.calibration.canister_pose import find_canister
from rhizotwin.recon.calibration.pose_errors import PoseErrors
from rhizotwin.recon.calibration.vessel_shape import refuse_corners
from rhizotwin.recon.calibration.view_fit import adjoint, twist
from rhizotwin.recon.optics.cameras import View, matrix
from rhizotwin.scenes import frames
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Camera, CapturePlan, Ring, Scene
from tests.recon.hull.exact_pictures import views_of

CAMERA = Camera(distortion=(-0.05, 0.02, 0.0003, -0.0002, 0.0)).resized((400, 300))
SCENE = Scene(camera=CAMERA, plan=CapturePlan(rings=(Ring(views=7, height_mm=-60.0, tilt_deg=3.0),)))
TRUE = frames.from_rotvec(np.deg2rad([0.4, -0.3, 0.0]), np.array([0.7, -0.5, 0.0]))


def picture(cam_from_canister: np.ndarray, rng: np.random.Generator, *, radius_mm: float, oval: complex) -> np.ndarray:
    """Draw the bare panel outside the wall, darkness at the edge and a brighter middle inside, with noise."""
    width, height = CAMERA.image_wh
    px = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1).reshape(-1, 1, 2).astype(np.float64)
    many = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-13)
    undone = cv2.undistortPoints(px, matrix(CAMERA), np.array(CAMERA.distortion), criteria=many).reshape(-1, 2)
    rays = np.concatenate([undone, np.ones((len(undone), 1))], axis=1) @ cam_from_canister[:3, :3]
    start = frames.invert(cam_from_canister)[:3, 3]
    mm_per_px = np.linalg.norm(start[:2]) / CAMERA.focal_px[0]
    heading = rays[:, :2] / np.hypot(rays[:, 0], rays[:, 1])[:, None]
    foot = start[:2] - np.sum(heading * start[:2], axis=1)[:, None] * heading
    # the support of an ellipse with semi-axes R + e and R - e, its longer one turned to half the phase of ``oval``
    across = np.arctan2(foot[:, 1], foot[:, 0]) - np.angle(oval) / 2.0
    support = np.hypot((radius_mm + abs(oval)) * np.cos(across), (radius_mm - abs(oval)) * np.sin(across))
    distance = np.hypot(foot[:, 0], foot[:, 1]) - support
    outside = np.clip(distance / mm_per_px + 0.5, 0.0, 1.0)
    light = 0.75 * outside + (1.0 - outside) * 0.6 * np.sqrt(np.clip(-distance / radius_mm, 0.0, 1.0))
    noisy = light + rng.normal(0.0, 0.01, len(light))
    return np.round(np.clip(noisy, 0.0, 1.0).reshape(height, width) * 65535.0).astype(np.uint16)


@cache
def scan(*, radius_mm: float = SCENE.canister.outer_radius_mm, oval: complex = 0.0) -> tuple[list[View], list[np.ndarray]]:
    """Return the cameras as the strip tells them and the pictures of the canister."""
    rng = np.random.default_rng(5)
    true = [view.cam_from_canister for view in views_of(SCENE)]
    images = [picture(cam_from_canister, rng, radius_mm=radius_mm, oval=oval) for cam_from_canister in true]
    return [View(camera=CAMERA, cam_from_canister=cam_from_canister @ TRUE) for cam_from_canister in true], images


@cache
def seat(**changes):
    views, images = scan(**changes)
    return find_canister(views, images.__getitem__, SCENE)


@pytest.mark.parametrize("larger", [{}, {"radius_mm": 76.45}], ids=["as stated", "another size"])
def test_the_seat_is_found_within_its_own_uncertainty(larger):
    found = seat(**larger)
    error = frames.invert(TRUE) @ found.canister_from_strip
    tilt_deg, shift_mm = np.rad2deg(frames.to_rotvec(error))[:2], error[:2, 3]
    assert np.abs(shift_mm).max() < 0.01
    assert np.abs(tilt_deg).max() < 0.01
    assert (np.abs(shift_mm) < 4.0 * found.sigma[2:]).all()
    assert found.radius_excess_mm == pytest.approx(larger.get("radius_mm", 76.2) - 76.2, abs=0.05)
    assert found.after_mm < 0.2 * found.before_mm
    assert found.oval_mm < 0.01


def test_errors_that_the_cameras_share_are_carried_through():
    views, images = scan()
    step = np.array([2e-3, -1e-3, 0.0, 0.1, -0.06, 0.0])  # of the strip: the canister in it seems to stand the other way
    carry, none = np.array([adjoint(view.cam_from_canister) for view in views]), np.zeros((len(views), 6, 6))
    errors = PoseErrors(shared=np.outer(step, step), carry=carry, own=none)
    exact, found = seat(), find_canister(views, images.__getitem__, SCENE, errors=errors)
    moved = [replace(view, cam_from_canister=view.cam_from_canister @ twist(step)) for view in views]
    off = find_canister(moved, images.__getitem__, SCENE).canister_from_strip @ frames.invert(found.canister_from_strip)
    change = np.concatenate([frames.to_rotvec(off)[:2], off[:2, 3]])
    np.testing.assert_allclose(found.by_cameras @ step, change, rtol=0.05)
    np.testing.assert_allclose(change, step[[0, 1, 3, 4]], rtol=0.05)
    assert (found.sigma > exact.sigma).any()
    assert (found.sigma >= exact.sigma).all()


def test_a_tube_out_of_round_is_told_with_its_direction():
    found = seat(oval=0.25 * np.exp(2j * np.deg2rad(35.0)))
    assert found.oval_mm == pytest.approx(0.25, abs=0.01)
    assert found.oval_deg == pytest.approx(35.0, abs=2.0)
    assert found.radius_excess_mm == pytest.approx(0.0, abs=0.05)
    assert np.abs((frames.invert(TRUE) @ found.canister_from_strip)[:2, 3]).max() < 0.01
    assert found.after_mm < 0.05


def test_no_edges_no_seat():
    views, images = scan()
    beyond = replace(SCENE, canister=replace(SCENE.canister, outer_radius_mm=150.0))  # its edges are outside of the pictures
    assert find_canister(views, images.__getitem__, beyond) is None
    assert [find_canister(views, lambda _, level=level: np.full_like(images[0], level), SCENE) for level in (0, 40000)] == [None, None]


def test_vessels_that_are_not_round_are_named() -> None:
    views, rng = views_of(SCENE), np.random.default_rng(0)

    def check(radius_mm: float, oval: complex) -> None:
        images = [picture(view.cam_from_canister, rng, radius_mm=radius_mm, oval=oval) for view in views]
        refuse_corners(views, images, SCENE)

    check(60.0, 0.0)  # round, but not as in the scene
    check(76.2, 1.0)
    with pytest.raises(UserError, match=r"the vessel is not round: its width in the pictures is 1[12].* to 1[45].* mm.*rectangular"):
        check(66.0, 11.0)
