"""Distance maps as they are kept, in halves."""

import mitsuba as mi
import numpy as np
import pytest
from scipy import ndimage

from rhizotwin.recon.coverage.silhouettes import UNSEEN_PX, Silhouette, Window
from rhizotwin.recon.hull.carve import carve
from rhizotwin.recon.hull.distance_maps import DistanceMaps, read
from rhizotwin.scenes.monitor import Monitor
from tests.recon.hull.test_agreement import scan

SHAPE = (3, 40, 60)
"""Views, and twice the pictures' rows and columns."""


def drawn() -> np.ndarray:
    """Distances from far outside to a sphere's depth; one view is silent on the right."""
    values = np.random.default_rng(0).uniform(-300.0, 100.0, SHAPE).astype(np.float32)
    values[1, :, 40:] = UNSEEN_PX
    return values


def test_halves_read_as_the_maps_they_were_made_of() -> None:
    values, rng = drawn(), np.random.default_rng(1)
    maps, px = DistanceMaps.from_arrays(values), rng.uniform((0.5, 0.5), (28.5, 18.5), (500, 2))
    for view in range(SHAPE[0]):
        at = (px[:, ::-1].T + 0.5) * 2.0 - 0.5
        true = ndimage.map_coordinates(values[view].astype(np.float64), at, order=1)
        found, tells = (np.array(part) for part in read(maps, mi.UInt32(view), mi.Vector2f(*px.T.astype(np.float32)), mi.Bool(True)))
        told = ndimage.map_coordinates((values[view] == UNSEEN_PX).astype(np.float64), at, order=1) < 1e-4
        assert (tells == told).mean() > 0.99, "a share of what is not seen is silence"
        # half of the last of eleven bits, from 256 to 512 px; the place in float32 is right to 1e-5 px
        np.testing.assert_allclose(found[tells & told], true[tells & told], atol=0.125 + 0.02)


def test_a_window_around_the_roots_carves_the_same_hull_as_whole_pictures() -> None:
    bank, shown, water = scan()
    whole = Window((0, 0), shown[0].coverage.shape[::-1])
    hulls = []
    for window in (Window.around(shown), whole):
        maps = DistanceMaps.compute(shown, "outlines", Monitor.of(None), window=window)
        hulls.append(carve(bank, maps, water.grid(0.5), water))
    assert np.prod(Window.around(shown).size_px) < 0.5 * np.prod(whole.size_px)
    small, large = hulls
    assert small.leaves.volume_mm3() == pytest.approx(large.leaves.volume_mm3(), rel=1e-4)
    assert small.moved_out_mm3 == pytest.approx(large.moved_out_mm3, rel=1e-4)
    assert abs(small.blind_mm3 - large.blind_mm3) < 1e-4 * np.pi * water.radius_mm**2 * (water.top_mm - water.bottom_mm)


def test_a_window_contains_what_may_hide_a_root_but_not_the_rim_of_the_canister() -> None:
    coverage, usable = np.zeros((100, 200), np.float32), np.zeros((100, 200), bool)
    usable[10:90, 20:180], coverage[10:40, 90:100] = True, 1.0
    plain = [Silhouette(coverage, usable)] * 3
    assert Window.around(plain) == Window((82, 6), (26, 42), ((62, 0), (72, 42)))
    speck, rim = usable.copy(), usable.copy()
    speck[60:63, 140:142], rim[:, 20:25] = False, False
    assert Window.around([*plain, Silhouette(coverage, rim)]) == Window.around(plain)
    around = Window.around([*plain, Silhouette(coverage, speck)])
    assert (around.low_px, around.size_px) == ((82, 6), (142 + 8 - 82, 63 + 8 - 6))
