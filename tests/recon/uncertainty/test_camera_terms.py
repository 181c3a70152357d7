"""What cameras without markers leave open, against shapes whose volume is known."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from rhizotwin.recon.calibration.cameras import BareUncertainty
from rhizotwin.recon.hull.leaves import Grid, Leaves
from rhizotwin.recon.optics import cameras
from rhizotwin.recon.optics.refraction import Optics
from rhizotwin.recon.uncertainty import bare_uncertainty
from rhizotwin.recon.uncertainty.budget import NINETY
from rhizotwin.recon.uncertainty.canister_uncertainty import CUBE_MM, misread
from tests.recon.hull.blocks import block
from tests.recon.hull.exact_pictures import ring_of, views_of

GRID = Grid.over(np.array([-32.0, -32.0, -32.0]), np.array([32.0, 32.0, 0.0]), 1.0)


def cube_at(x_mm: int) -> Leaves:
    """Return a cube of 4 mm whose middle is at (x, 0, -10)."""
    return block(GRID, np.argwhere(np.ones((4, 4, 4))) + np.array([x_mm - 2, -2, -12]) - np.asarray(GRID.origin_mm))


def terms_at(x_mm: int, *, scale: float = 0.0, azimuth_rad: float = 0.0, lift_mm: float = 0.0):
    known = BareUncertainty(scale=scale, azimuth_rad=azimuth_rad, lift_mm=lift_mm, mm_per_px=0.5)
    return bare_uncertainty.camera_terms(known, cube_at(x_mm), views=25, mm3_per_px=48.0)


def test_a_scale_counts_three_times() -> None:
    scale, cameras = terms_at(0, scale=0.001)
    grown = 64.0 * (1.0 + NINETY * 0.001) ** 3 - 64.0
    assert scale.less_mm3 == scale.more_mm3 == pytest.approx(grown, rel=0.01)
    assert cameras.more_mm3 == 0.0


def test_an_angle_counts_by_distance_and_a_lift_everywhere() -> None:
    far, farther = (terms_at(x, azimuth_rad=0.01)[1] for x in (10, 20))
    away = np.sqrt(10.0**2 + 2.0 * 15.0 / 12.0)  # the middles of four cells a side scatter by sqrt(15 / 12)
    assert far.more_mm3 == pytest.approx(NINETY * 0.01 * away / np.sqrt(2.0) / 0.5 * 48.0, rel=1e-3)
    assert farther.more_mm3 == pytest.approx(2.0 * far.more_mm3, rel=0.02)
    assert far.less_mm3 == pytest.approx(0.2 * far.more_mm3)
    assert [terms_at(x, lift_mm=0.1)[1].more_mm3 for x in (0, 20)] == [pytest.approx(NINETY * 0.1 / 0.5 * 48.0)] * 2
    assert bare_uncertainty.camera_terms(None, cube_at(0), views=20, mm3_per_px=48.0) == ()


SCENE = ring_of(3)
BELIEVED, VIEWS = Optics.from_scene(SCENE), views_of(SCENE)
OTHERS = {
    "wall": replace(BELIEVED, inner_radius_mm=BELIEVED.inner_radius_mm - 0.3),
    "radius": replace(BELIEVED, outer_radius_mm=BELIEVED.outer_radius_mm + 0.7, inner_radius_mm=BELIEVED.inner_radius_mm + 0.7),
}
POINT_MM = np.array([[22.0, -14.0, -70.0]])


def found(true: Optics, point: np.ndarray) -> np.ndarray:
    """Return where a point is found that is seen through another canister."""
    seen = [(view, cameras.project_inner(view, true, point[None])) for view in VIEWS]

    def off(at: np.ndarray) -> np.ndarray:
        return np.concatenate([(cameras.project_inner(view, BELIEVED, at[None]) - px).ravel() for view, px in seen])

    return np.asarray(least_squares(off, point, x_scale=0.01).x)


@pytest.mark.parametrize("name", OTHERS)
def test_misread_is_what_looking_for_every_point_gives(name: str) -> None:
    true = OTHERS[name]
    ends = [[found(true, POINT_MM[0] + 0.5 * side * CUBE_MM * np.eye(3)[axis]) for side in (-1.0, 1.0)] for axis in range(3)]
    slowly = float(np.linalg.det(np.array([(high - low) / CUBE_MM for low, high in ends])) - 1.0)
    quickly = misread(VIEWS, BELIEVED, true, POINT_MM)
    assert quickly == pytest.approx(slowly, rel=1e-3)
    assert abs(slowly) > 1e-5
    assert misread(VIEWS, BELIEVED, BELIEVED, POINT_MM) == pytest.approx(0.0, abs=1e-7)
