"""A tank that stands otherwise than its scene says: the twin's pictures, followed by the reconstruction's own mathematics to a hull."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rhizotwin.recon import carved_hull
from rhizotwin.recon.calibration.find_cameras import find_cameras
from rhizotwin.recon.coverage.measure import measure_coverage
from rhizotwin.recon.read_pictures import read_pictures
from rhizotwin.recon.settings import Settings
from rhizotwin.scenes import files
from rhizotwin.scenes.model import CapturePlan, Ring, Scene, Tank
from rhizotwin.scenes.monitor import Monitor
from rhizotwin.scenes.specimens import SphereSpecimen
from rhizotwin.sim.simulate import simulate

pytestmark = pytest.mark.slow

TURN_DEG = 1.0
BALL = SphereSpecimen(diameter_mm=12.0, centre_mm=(58.0, 20.0, -60.0))
"""Its middle lies beyond R_o / n_water = 57 mm, where the canister in the open is blind from the side."""
VOLUME_MM3 = np.pi / 6.0 * BALL.diameter_mm**3


def test_a_ball_beside_the_wall_is_found_through_a_turned_tank(tmp_path: Path) -> None:
    true = Scene(
        camera=Scene().camera.resized((400, 300)),
        plan=CapturePlan(rings=(Ring(views=13),)),
        specimen=BALL,
        tank=Tank(turn_deg=TURN_DEG),
        disturbances=files.load_profile("bench"),
    )
    dataset = simulate(true, tmp_path / "scan", profile_name="bench", seed=3)
    dataset = replace(dataset, scene=replace(dataset.scene, tank=Tank()))
    monitor = Monitor.of(None)
    pictures = read_pictures(dataset, monitor=monitor)
    cameras = find_cameras(pictures, monitor=monitor)
    assert len(cameras.order) == 13
    found = cameras.markers.canister
    assert found.tank_turn_deg == pytest.approx(TURN_DEG, abs=0.1)
    assert abs(found.tank_turn_deg - TURN_DEG) < 4.0 * found.tank_sigma_deg
    cameras, coverage = measure_coverage(pictures, cameras, monitor=monitor)
    hull = carved_hull.find_hull(dataset, cameras, coverage, Settings(), monitor=monitor).hull.leaves
    assert hull.volume_mm3() == pytest.approx(VOLUME_MM3, rel=0.05)
    size = hull.size.astype(np.float64)
    centres_mm = hull.grid.origin_mm + hull.grid.size_mm * (hull.index + 0.5 * size[:, None])
    middle = np.average(centres_mm, axis=0, weights=hull.occupancy * size**3)
    assert np.linalg.norm(middle - BALL.centre_mm) < 0.15
