"""Films and bubbles on the canister's wall, told from roots by turning the canister."""

import numpy as np
import pytest

from rhizotwin.recon.coverage import wall
from rhizotwin.recon.optics import cameras
from rhizotwin.scenes.monitor import Monitor
from tests.recon.coverage.conftest import Turn


def painted(shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Paint a wall with a film of optical depth 0.2, and one with a bubble and a thin root that runs down."""
    film, things = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
    film[40:52, 100:114] = 0.2
    things[70:73, 200:203] = 1.5
    things[30:110, 300] = 0.6
    return film, things


def test_films_are_given_back_and_bubbles_are_not_seen_but_roots_on_the_wall_stay(turn: Turn) -> None:
    views, optics, seen = turn
    film, things = painted(wall.INSIDE.shape(optics))
    where = {k: wall.crossings(view, optics) for k, view in views.items()}
    depth = {k: sum(wall.look_up(film + things, where[k].column[side], where[k].row[side]) for side in (0, 1)) * seen[k] for k in views}
    opacity = {k: (1.0 - np.exp(-d)).astype(np.float32) for k, d in depth.items()}
    found = wall.detect_fouling(opacity, seen, where, optics, Monitor())
    assert found.film[44:48, 104:110] == pytest.approx(0.2, abs=0.02)
    assert found.bubbles[71, 201], "the bubble stands alone"
    assert not found.bubbles[:, 290:312].any(), "the root goes on"
    assert (found.film[30:110, 298:304] < 0.03).all(), "the root is no film"
    before = after = 0.0
    for k in views:
        free, visible = wall.remove_fouling(opacity[k], seen[k], where[k], found)
        root = sum(wall.look_up(things, where[k].column[side], where[k].row[side]) for side in (0, 1))
        clear = seen[k] & visible & (root == 0)
        before, after = before + float(opacity[k][clear].sum()), after + float(np.abs(free[clear]).sum())
    assert after < 0.25 * before


def test_lines_of_sight_cross_the_wall_where_its_points_are_projected(turn: Turn) -> None:
    views, optics, _ = turn
    rows, columns = wall.INSIDE.shape(optics)
    view = views[3]
    where = wall.crossings(view, optics)
    x, y, _ = view.centre_mm
    for side, ahead in ((0, 0.4), (1, np.pi - 0.2)):
        azimuth = np.arctan2(y, x) + ahead
        point = np.array([[optics.inner_radius_mm * np.cos(azimuth), optics.inner_radius_mm * np.sin(azimuth), -60.0]]) * (1.0 - 1e-9)
        px, count = cameras.project(view, optics, point)
        assert count[0] == 1
        u, v = np.rint(px[0, 0]).astype(int)
        column = np.mod(azimuth * columns / (2 * np.pi) - 0.5 - where.column[side][v, u] + columns / 2, columns) - columns / 2
        assert abs(column) < 1.5, "within the pixel"
        assert where.row[side][v, u] == pytest.approx((optics.water_z_mm + 60.0) * rows / (optics.water_z_mm - optics.floor_z_mm), abs=1.5)


def test_what_is_clear_wherever_one_looks_past_the_crowd_is_no_bubble() -> None:
    """A crowd inside darkens a place in six of ten views; in the others it is as clear as its ring, but for a true bubble."""
    dark = np.zeros((20, 60), np.float32)
    dark[9:12, 30:33] = 0.5
    views = np.zeros((10, 20, 60), np.float32)
    views[:6] = 0.5
    assert not wall._bubbles(dark, views, 0.06).any()
    views[6:, 9:12, 30:33] = 0.4
    assert wall._bubbles(dark, views, 0.06)[9:12, 30:33].all()
