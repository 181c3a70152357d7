"""What cameras without markers leave open, against shapes whose volume is known."""

import numpy as np
import pytest

from rhizotwin.recon.calibration.cameras import BareUncertainty
from rhizotwin.recon.hull.leaves import Grid, Leaves
from rhizotwin.recon.uncertainty import bare_uncertainty
from rhizotwin.recon.uncertainty.budget import NINETY

GRID = Grid.over(np.array([-32.0, -32.0, -32.0]), np.array([32.0, 32.0, 0.0]), 1.0)


def cube_at(x_mm: int) -> Leaves:
    """Return a cube of 4 mm whose middle is at (x, 0, -10)."""
    corner = np.array([x_mm - 2, -2, -12]) - np.asarray(GRID.origin_mm)
    index = np.stack(np.meshgrid(*(np.arange(4),) * 3, indexing="ij"), axis=-1).reshape(-1, 3) + corner
    return Leaves(grid=GRID, index=index.astype(np.int32), size=np.ones(64, np.int32), occupancy=np.ones(64, np.float32))


def known(*, scale: float = 0.0, azimuth_rad: float = 0.0, lift_mm: float = 0.0) -> BareUncertainty:
    return BareUncertainty(scale=scale, azimuth_rad=azimuth_rad, lift_mm=lift_mm, mm_per_px=0.5)


def test_a_scale_counts_three_times() -> None:
    scale, cameras = bare_uncertainty.camera_terms(known(scale=0.001), cube_at(0), views=20, mm3_per_px=48.0)
    grown = 64.0 * (1.0 + NINETY * 0.001) ** 3 - 64.0
    assert scale.less_mm3 == scale.more_mm3 == pytest.approx(grown, rel=0.01)
    assert cameras.more_mm3 == 0.0


def test_an_angle_counts_by_the_distance_from_the_axis_and_a_lift_alike() -> None:
    far, farther = (bare_uncertainty.camera_terms(known(azimuth_rad=0.01), cube_at(x), views=25, mm3_per_px=48.0)[1] for x in (10, 20))
    away = np.sqrt(10.0**2 + 2.0 * 15.0 / 12.0)  # the middles of four cells a side scatter by sqrt(15 / 12)
    assert far.more_mm3 == pytest.approx(NINETY * 0.01 * away / np.sqrt(2.0) / 0.5 * 48.0, rel=1e-3)
    assert farther.more_mm3 == pytest.approx(2.0 * far.more_mm3, rel=0.02)
    assert far.less_mm3 == pytest.approx(0.2 * far.more_mm3)
    lifted = [bare_uncertainty.camera_terms(known(lift_mm=0.1), cube_at(x), views=25, mm3_per_px=48.0)[1].more_mm3 for x in (0, 20)]
    assert lifted == [pytest.approx(NINETY * 0.1 / 0.5 * 48.0)] * 2
    assert bare_uncertainty.camera_terms(None, cube_at(0), views=20, mm3_per_px=48.0) == ()
