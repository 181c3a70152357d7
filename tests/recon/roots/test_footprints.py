"""Footprints of cells: packed positions and areas, and the shadows they cast, as plain numpy does it."""

import mitsuba as mi
import numpy as np
import pytest

from rhizotwin.recon.coverage.evidence import Evidence
from rhizotwin.recon.coverage.silhouettes import Silhouette
from rhizotwin.recon.roots.footprints import Footprints, Table, Windows
from tests.recon.hull.exact_pictures import ring_of
from tests.recon.strings import blank_of

VIEWS, WIDTH, HEIGHT = 5, 200, 150


def test_shadows_fall_where_the_cells_are() -> None:
    """The second picture says nothing in its left half."""
    empty, told = blank_of(ring_of(VIEWS, (WIDTH, HEIGHT))), np.ones((VIEWS, HEIGHT, WIDTH), bool)
    told[1, :, : WIDTH // 2] = False
    seen = Evidence.from_silhouettes(empty.bank, [Silhouette(np.zeros((HEIGHT, WIDTH), np.float32), part) for part in told])
    rng = np.random.default_rng(6)
    points_mm, amount = rng.uniform((-8.0, -8.0, -50.0), (8.0, 8.0, -30.0), (300, 3)), rng.random(300)
    at, view = seen.project(points_mm), np.arange(VIEWS)[:, None]
    nearest, low = np.floor(at.px + 0.5).astype(int), np.floor(at.px).astype(int)
    shown = at.visible & told[view, nearest[..., 1], nearest[..., 0]]
    area, f = np.where(shown, np.linalg.norm(np.cross(at.du, at.dv), axis=-1), 0.0), at.px - low
    expected = np.zeros((VIEWS, HEIGHT, WIDTH))
    for i, j in np.ndindex(2, 2):
        share = np.abs(1 - i - f[..., 0]) * np.abs(1 - j - f[..., 1])
        np.add.at(expected, (view, low[..., 1] + j, low[..., 0] + i), share * area * amount)
    footprints = Footprints.project(seen, points_mm)
    table = Table(footprints, Windows.around(footprints))
    views = range(1, 4)
    found = table.shadows(views, mi.Float(amount.astype(np.float32)))
    whole = np.array(table.windows.cut(seen, mi.Float(expected.ravel().astype(np.float32))))
    pixels = table.windows.pixels
    np.testing.assert_allclose(np.array(found), whole[pixels * views.start : pixels * views.stop], atol=0.02 * expected.max())
    assert whole.sum() == pytest.approx(expected.sum())  # the windows hold all shadows
    assert len(whole) < 0.5 * expected.size
