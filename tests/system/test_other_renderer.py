"""The reconstruction finds what another renderer draws: pictures that `sim` did not make, of a root whose size is known in closed form."""

from pathlib import Path

import numpy as np
import pytest

from rhizotwin.recon.reconstruct import reconstruct
from rhizotwin.recon.results.result import Result
from rhizotwin.scenes.atomic import write_image
from rhizotwin.scenes.dataset import Dataset, Frame, file_sha256, save_dataset
from rhizotwin.scenes.model import Camera, CapturePlan, Ring, Scene
from tests.system import snell

pytestmark = pytest.mark.slow

IMAGE_WH = (320, 240)
FOCAL_PX = 1300.0 * IMAGE_WH[0] / 800.0
VIEWS = 24
RINGS = ((-42.0, 0.0, 0.0), (10.0, 8.0, 7.5))
"""Height, tilt and first azimuth of the cameras."""
ROOT = [
    snell.Capsule((0.0, 0.0, -14.0), (1.0, -1.0, -40.0), 2.4),
    snell.Capsule((1.0, -1.0, -40.0), (-2.0, 1.0, -75.0), 1.6),
    snell.Capsule((0.5, -0.5, -25.0), (26.0, 8.0, -52.0), 0.9),
    snell.Capsule((1.0, -1.0, -36.0), (-24.0, -14.0, -58.0), 0.9),
    snell.Capsule((0.0, 0.0, -50.0), (-6.0, 22.0, -66.0), 0.8),
]


@pytest.fixture
def result(tmp_path: Path) -> Result:
    folder, rng = tmp_path / "scan", np.random.default_rng(7)
    frames = []
    for k in range(VIEWS):
        ring, place = k % 2, k // 2
        height_mm, down_deg, first_deg = RINGS[ring]
        pose = snell.pose(first_deg + 360.0 * place / (VIEWS / 2), distance_mm=400.0, height_mm=height_mm, down_deg=down_deg)
        light = snell.picture(ROOT, pose, image_wh=IMAGE_WH, focal_px=FOCAL_PX, rng=rng)
        file = f"images/view_{k:03d}.png"
        write_image(folder / file, np.round(65535.0 * light).astype(np.uint16))
        rows = tuple(tuple(float(value) for value in row) for row in pose)
        frames.append(Frame(file=file, sha256=file_sha256(folder / file), ring=ring, cam_from_canister=rows))
    rings = tuple(Ring(views=VIEWS // 2, height_mm=height, tilt_deg=tilt) for height, tilt, _ in RINGS)
    scene = Scene(name="capsules", camera=Camera().resized(IMAGE_WH), plan=CapturePlan(rings=rings))
    save_dataset(Dataset(folder=folder, scene=scene, frames=tuple(frames), seed=0))
    return reconstruct(folder)


def test_volume_interval_and_place_are_those_of_what_was_drawn(result: Result) -> None:
    true_mm3 = snell.union_mm3(ROOT, rng=np.random.default_rng(2))
    low, high = result.interval_mm3
    assert result.volume_mm3 == pytest.approx(true_mm3, rel=0.06)
    assert low < true_mm3 < high
    ends = np.array([[capsule.start_mm, capsule.end_mm] for capsule in ROOT]).reshape(-1, 3)
    radii = np.repeat([capsule.radius_mm for capsule in ROOT], 2)[:, None]
    assert result.solid.extents_min_mm == pytest.approx((ends - radii).min(axis=0), abs=0.6)  # a half of a pixel's width
    assert result.solid.extents_max_mm[0] == pytest.approx((ends + radii).max(axis=0)[0], abs=0.6)  # its top stands before the dark pot
