"""Footprints of cells: packed positions and areas, shadows cast and pictures read as plain numpy does it."""

import mitsuba as mi
import numpy as np
import pytest

from rhizotwin.recon.coverage.evidence import Evidence
from rhizotwin.recon.coverage.silhouettes import Silhouette
from rhizotwin.recon.roots import density
from rhizotwin.recon.roots.footprints import Footprints, Table, Windows
from tests.recon.hull.exact_pictures import ring_of
from tests.recon.strings import blank_of

VIEWS, WIDTH, HEIGHT = 5, 200, 150


@pytest.fixture(scope="module")
def seen() -> Evidence:
    """Evidence that says nothing in the left half of the second picture."""
    empty = blank_of(ring_of(VIEWS, (WIDTH, HEIGHT)))
    told, rng = np.ones((VIEWS, HEIGHT, WIDTH), bool), np.random.default_rng(5)
    told[1, :, : WIDTH // 2] = False
    return Evidence.from_silhouettes(empty.bank, [Silhouette(rng.random((HEIGHT, WIDTH)).astype(np.float32), part) for part in told])


@pytest.fixture(scope="module")
def points_mm() -> np.ndarray:
    return np.random.default_rng(6).uniform((-8.0, -8.0, -50.0), (8.0, 8.0, -30.0), (300, 3))


def reference(seen: Evidence, points_mm: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return pixels (V, N, 2) and areas (V, N), 0 where nothing is told."""
    at = seen.project(points_mm)
    told = np.array(seen.usable).reshape(VIEWS, HEIGHT, WIDTH) > 0
    nearest = np.floor(at.px + 0.5).astype(int)
    shown = at.visible & told[np.arange(VIEWS)[:, None], nearest[..., 1], nearest[..., 0]]
    return at.px, np.where(shown, np.linalg.norm(np.cross(at.du, at.dv), axis=-1), 0.0)


def shares(px: np.ndarray) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Return row, column and share of the four pixels about each position."""
    low = np.floor(px).astype(int)
    f = px - low
    return [(low[..., 1] + j, low[..., 0] + i, np.abs(1 - i - f[..., 0]) * np.abs(1 - j - f[..., 1])) for i in (0, 1) for j in (0, 1)]


def table_of(seen: Evidence, points_mm: np.ndarray) -> Table:
    footprints = Footprints.project(seen, points_mm)
    return Table(footprints, Windows.around(footprints))


def test_shadows_fall_where_the_cells_are(seen: Evidence, points_mm: np.ndarray) -> None:
    px, area = reference(seen, points_mm)
    amount = np.random.default_rng(7).random(len(points_mm))
    expected = np.zeros((VIEWS, HEIGHT, WIDTH))
    for row, column, share in shares(px):
        np.add.at(expected, (np.arange(VIEWS)[:, None], row, column), share * area * amount)
    table = table_of(seen, points_mm)
    views = range(1, 4)
    found = table.shadows(views, mi.Float(amount.astype(np.float32)))
    whole = np.array(table.windows.cut(seen, mi.Float(expected.ravel().astype(np.float32))))
    pixels = table.windows.pixels
    np.testing.assert_allclose(np.array(found), whole[pixels * views.start : pixels * views.stop], atol=0.02 * expected.max())
    assert whole.sum() == pytest.approx(expected.sum())  # the windows hold all shadows
    assert len(whole) < 0.5 * expected.size


def test_pictures_are_read_where_cells_are_seen(seen: Evidence, points_mm: np.ndarray) -> None:
    px, area = reference(seen, points_mm)
    picture = np.array(seen.coverage).reshape(VIEWS, HEIGHT, WIDTH)
    value = sum(picture[np.arange(VIEWS)[:, None], row, column] * share for row, column, share in shares(px))
    told = area > 0
    expected = (np.log(np.clip(value, 0.2, 0.9)) * told).sum(axis=0) / np.maximum(told.sum(axis=0), 1)
    table = table_of(seen, points_mm)
    found = table.mean_log(table.windows.cut(seen, seen.coverage), range(VIEWS), 0.2, 0.9)
    np.testing.assert_allclose(np.array(found), expected, atol=0.02)
    assert not told[1].all()


@pytest.mark.parametrize("views", [3, 24, 41, 200])
def test_every_schedule_takes_the_same_steps(views: int) -> None:
    counts = density.schedule(views)
    assert sum(counts) == density.STEPS
    assert min(counts) > 0
    assert max(counts) * 10 <= max(views, 10)
