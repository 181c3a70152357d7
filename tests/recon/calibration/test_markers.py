"""Markers: corners in pictures of the emulated rig, which shares nothing with them, and what is said when there are none."""

from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from rhizotwin.recon.calibration.marker_fit import fit_marker
from rhizotwin.recon.calibration.markers import Markers, detect_markers
from rhizotwin.recon.optics.cameras import matrix
from rhizotwin.rig.twin.sketch import Sketch
from rhizotwin.rig.twin.world import Sight
from rhizotwin.scenes import frames, plan
from rhizotwin.scenes.dataset import Dataset
from rhizotwin.scenes.model import Camera, MarkerStrip, Scene


@dataclass(frozen=True)
class Shot:
    """A picture with its truth and what was found."""

    scene: Scene
    cam_from_canister: frames.Array
    picture: NDArray[np.uint16]
    markers: Markers

    @property
    def true_px(self) -> frames.Array:
        """Return the corners of the found markers (M, 4, 2)."""
        where = plan.marker_corners(self.scene.strip, self.scene.net_pot)
        points = np.concatenate([where[int(k)] for k in self.markers.ids])
        turn = cv2.Rodrigues(self.cam_from_canister[:3, :3])[0]
        lens = np.array(self.scene.camera.distortion)
        return cv2.projectPoints(points, turn, self.cam_from_canister[:3, 3], matrix(self.scene.camera), lens)[0].reshape(-1, 4, 2)


@pytest.fixture(scope="module")
def shot() -> Shot:
    """Take a blurred, noisy picture through a bent lens, by a camera that is not quite level."""
    scene = Scene(camera=Camera(distortion=(-0.12, 0.05, 0.0005, -0.0003, 0.0)))
    pose = plan.views(scene)[0].cam_from_rig @ frames.from_rotvec(np.array([0.01, -0.015, 0.4]), np.array([0.5, -0.8, 0.3]))
    fine, still = replace(scene, camera=scene.camera.resized((1600, 1200))), np.eye(4)
    sketch = Sketch(fine, distortion=scene.camera.distortion, canister_from_strip=still)
    light = sketch.light(Sight(cam_from_rig=pose, rig_from_canister=still, table_deg=0.0, panel=1.0, front=1.0))
    light, rng = cv2.GaussianBlur(cv2.resize(light, (800, 600), interpolation=cv2.INTER_AREA), (0, 0), 1.0), np.random.default_rng(3)
    noisy = (rng.poisson(light * 8000.0) + rng.normal(0.0, 3.0, light.shape)) / 8000.0
    picture = (np.clip(np.round(noisy * 4095.0), 0, 4095) * 16).astype(np.uint16)
    return Shot(scene, pose, picture, detect_markers(picture, scene.strip))


def test_markers_are_measured_to_a_few_hundredths_of_a_pixel(shot):
    off = shot.markers.corners_px - shot.true_px
    assert np.bincount(shot.markers.ids // shot.scene.strip.columns, minlength=2).min() >= 7
    assert np.sqrt(np.mean(off**2)) < 0.06
    assert np.abs(np.median(off, axis=(0, 1))).max() < 0.015
    outwards = np.sign(shot.true_px - shot.true_px.mean(axis=1, keepdims=True))
    assert abs(np.median(np.mean(off * outwards, axis=(1, 2)))) < 0.015, "blur pulls no corner inwards"
    covariance, off = shot.markers.covariance_px2, off.reshape(-1, 8)
    normalised = np.einsum("mi,mij,mj->m", off, np.linalg.inv(covariance + 0.02**2 * np.eye(8)), off) / 8.0
    assert 0.1 < np.median(normalised) < 4.0
    assert np.linalg.eigvalsh(covariance).min() > 0.0
    opencv = replace(shot, markers=detect_markers(shot.picture, shot.scene.strip, measure=False))
    assert set(shot.markers.ids) <= set(opencv.markers.ids)
    assert np.median(np.abs(off)) < 0.2 * np.median(np.abs(opencv.markers.corners_px - opencv.true_px))


def test_a_flat_marker_on_the_grid_is_measured_at_its_edges():
    """A marker 192 px wide, larger than what is fitted without averaging, whose left edge lies between pixels 99 and 100."""
    white = cv2.aruco.generateImageMarker(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11), 7, 8) > 127
    picture = np.full((400, 420), 40000, np.uint16)
    picture[80:272, 100:292] = np.where(np.kron(white, np.ones((24, 24))), 40000, 2000)
    picture = cv2.GaussianBlur(picture, (0, 0), 2.0)
    true_px = np.array([[99.5, 79.5], [291.5, 79.5], [291.5, 271.5], [99.5, 271.5]])
    fit = fit_marker(picture, white, true_px + np.array([[1.0, -0.7], [-0.5, 0.8], [0.9, 0.4], [0.0, -1.0]]))
    np.testing.assert_allclose(fit.corners_px, true_px, atol=0.04)


@pytest.mark.parametrize(
    ("change", "least"),
    [(lambda one: np.where(one > 0.6 * 65535, one, one // 12).astype(np.uint16), 10), (lambda one: (one >> 8).astype(np.uint8), 14)],
    ids=["a strip much darker than the backlight", "8 bits"],
)
def test_markers_are_found_in_other_pictures(shot, change, least):
    picture, half = change(shot.picture), replace(shot.scene.strip, rows=1)
    assert len(detect_markers(picture, shot.scene.strip).ids) >= least
    assert max(detect_markers(picture, half).ids) < half.columns, "only ids of the strip are kept"


@pytest.mark.parametrize(
    ("change", "strip", "diagnosis"),
    [
        (lambda picture: np.ascontiguousarray(picture[:, ::-1]), MarkerStrip(), "mirror"),
        (lambda picture: picture, MarkerStrip(first_id=200), "markers of another strip"),
        (
            lambda picture: np.full_like(picture, 30000),
            MarkerStrip(),
            "no markers were found; according to the record of the scan, the front lamp was off",
        ),
    ],
    ids=["mirrored", "other ids", "empty"],
)
def test_a_picture_without_the_strip_s_markers_is_diagnosed(shot, change, strip, diagnosis):
    scan = Dataset(folder=Path(), scene=Scene(), frames=(), origin={"rig": {"lights": {"panel_level": 1.0, "front_level": 0.0}}})
    found = detect_markers(change(shot.picture), strip, lamps_off=scan.lamps_off)
    assert len(found.ids) == 0
    assert diagnosis in found.diagnosis
    assert Dataset(folder=Path(), scene=Scene(), frames=(), origin={"rig": None}).lamps_off == ()
