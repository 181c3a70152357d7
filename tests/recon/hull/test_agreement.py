"""Views that contradict all others, among exact silhouettes of a plant of rods."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache

import mitsuba as mi
import numpy as np
import pytest
from scipy import ndimage
from scipy.spatial import cKDTree

from rhizotwin.recon.coverage.silhouettes import UNSEEN_PX, Silhouette, Window
from rhizotwin.recon.hull import agreement
from rhizotwin.recon.hull.boxes import CellSet
from rhizotwin.recon.hull.carve import Water, carve
from rhizotwin.recon.hull.distance_maps import DistanceMaps, read
from rhizotwin.recon.hull.leaves import Hull, Leaves, to_unit_cubes
from rhizotwin.recon.hull.regularised import regularise
from rhizotwin.recon.optics.projection import ViewBank
from rhizotwin.recon.optics.refraction import Optics
from rhizotwin.scenes.monitor import Monitor
from tests.recon.hull import exact_pictures

RODS = (
    ((2.0, 0.0, -12.0), (1.0, 1.0, -70.0), 1.0),
    ((2.0, 0.0, -25.0), (25.0, 5.0, -45.0), 0.5),
    ((1.5, 0.5, -35.0), (-12.0, 16.0, -60.0), 0.5),
    ((1.5, 0.5, -40.0), (4.0, -20.0, -50.0), 0.5),
)
WRONG = 4


@cache
def scan() -> tuple[ViewBank, tuple[Silhouette, ...], Water]:
    scene = exact_pictures.ring_of(20, (240, 180))
    optics, views = Optics.from_scene(scene), exact_pictures.views_of(scene)
    shown = tuple(exact_pictures.drawn(view, optics, RODS) for view in views)
    return ViewBank.pack(views, optics), shown, Water(optics.inner_radius_mm, -8.0, -120.0)


def mirrored(one: Silhouette) -> Silhouette:
    return replace(one, coverage=one.coverage[:, ::-1] * one.usable)


def below(one: Silhouette, level: float) -> Silhouette:
    rows = np.arange(len(one.coverage))[:, None]
    return replace(one, coverage=np.where(rows < len(rows) // 3, one.coverage, level).astype(np.float32))


@pytest.mark.parametrize(
    ("spoil", "wrong", "named"),
    [
        (mirrored, [], []),
        (mirrored, [WRONG], [WRONG]),
        (lambda one: below(one, 0.0), [WRONG], [WRONG]),
        (lambda one: below(one, 1.0), [WRONG], [WRONG]),
        (mirrored, [0, 1, 2, 3, 4, 5], []),
    ],
    ids=["none", "mirrored", "bright below", "dark below", "too many to be named"],
)
def test_a_wrong_view_is_found(spoil: Callable[[Silhouette], Silhouette], wrong: list[int], named: list[int]) -> None:
    bank, silhouettes, water = scan()
    spoilt = [spoil(one) if k in wrong else one for k, one in enumerate(silhouettes)]
    assert agreement.find_wrong_views(bank, spoilt, water) == named


def test_a_cube_in_the_wrong_place_is_excluded_and_roots_missed() -> None:
    bank, silhouettes, _ = scan()
    found = agreement.compare(bank, silhouettes, np.array([[1.5, 0.5, -41.0], [-20.0, -20.0, -41.0]]), np.ones(2))
    assert not found.excluded[:, 0].any()
    assert found.excluded[:, 1].mean() > 0.7
    assert found.share > 0.9


SIZE_MM = 0.5


def mended(silhouettes: Sequence[Silhouette]) -> tuple[Leaves, Leaves]:
    """Return a carved shape, and the same regularised."""
    bank, _, water = scan()
    maps = DistanceMaps.compute(silhouettes, "outlines", Monitor.of(None))
    hull = carve(bank, maps, water.grid(SIZE_MM), water, slack_px=2.0, ignore_blindness=True)
    return hull.leaves.select(hull.leaves.occupancy >= 0.5), regularise(bank, silhouettes, hull)


def parts(leaves: Leaves) -> int:
    return int(CellSet.from_cells(to_unit_cubes(leaves.index, leaves.size)).components().max()) + 1


def found_share(leaves: Leaves) -> float:
    """Return the share of the rods' centre lines within a voxel of the shape."""
    lines = np.concatenate([np.linspace(a, b, 100) for a, b, _ in RODS])
    middles = leaves.grid.origin_mm + (to_unit_cubes(leaves.index, leaves.size) + 0.5) * SIZE_MM
    return float((cKDTree(middles).query(lines)[0] < 2.0 * SIZE_MM).mean())


def test_parts_that_shifted_pictures_cut_are_joined() -> None:
    """Pictures are moved sideways, as poses that are off do; the regularised shape covers the one that shows most."""
    rng, bank = np.random.default_rng(5), scan()[0]
    silhouettes = [replace(one, coverage=np.roll(one.coverage, int(rng.integers(-1, 2)), axis=1)) for one in scan()[1]]
    before, after = mended(silhouettes)
    assert parts(before) > 1
    assert parts(after) == 1
    assert found_share(before) < 0.5
    assert found_share(after) > 0.8
    reference = int(np.argmax([one.coverage[one.usable].sum() for one in silhouettes]))
    one, of = silhouettes[reference], bank.select([reference])
    missed = [agreement.missed_pixels(of, one, made.middles_mm, SIZE_MM * made.size.astype(float)).sum() for made in (before, after)]
    assert missed[1] < 0.1 * missed[0]
    kept, every = ({tuple(cell) for cell in to_unit_cubes(made.index, made.size).tolist()} for made in (before, after))
    assert kept <= every


def test_a_whole_shape_stays_nearly_as_it_is() -> None:
    before, after = mended(scan()[1])
    assert after.volume_mm3() == pytest.approx(before.volume_mm3(), rel=0.1)
    nothing = before.select(slice(0))
    assert len(regularise(*scan()[:2], Hull(nothing, nothing.occupancy, 0.0, 0.0)).size) == 0


SHAPE = (3, 40, 60)
"""Views, and twice the pictures' rows and columns."""


@pytest.mark.parametrize("view", range(SHAPE[0]))
def test_halves_read_as_the_maps_they_were_made_of(view: int) -> None:
    """Distances from far outside to a sphere's depth; one view is silent on the right."""
    values, rng = np.random.default_rng(0).uniform(-300.0, 100.0, SHAPE).astype(np.float32), np.random.default_rng(1)
    values[1, :, 40:] = UNSEEN_PX
    maps, px = DistanceMaps.from_arrays(values), rng.uniform((0.5, 0.5), (28.5, 18.5), (500, 2))
    at = (px[:, ::-1].T + 0.5) * 2.0 - 0.5
    true = ndimage.map_coordinates(values[view].astype(np.float64), at, order=1)
    found, tells = (np.array(part) for part in read(maps, mi.UInt32(view), mi.Vector2f(*px.T.astype(np.float32)), mi.Bool(True)))
    told = ndimage.map_coordinates((values[view] == UNSEEN_PX).astype(np.float64), at, order=1) < 1e-4
    assert (tells == told).mean() > 0.99, "a share of what is not seen is silence"
    # half of the last of eleven bits, from 256 to 512 px; the place in float32 is right to 1e-5 px
    np.testing.assert_allclose(found[tells & told], true[tells & told], atol=0.125 + 0.02)


def test_a_window_around_roots_carves_the_same_as_whole_pictures() -> None:
    bank, shown, water = scan()
    whole = Window((0, 0), shown[0].coverage.shape[::-1])
    maps = (DistanceMaps.compute(shown, "outlines", Monitor.of(None), window=window) for window in (Window.around(shown), whole))
    small, large = (carve(bank, one, water.grid(0.5), water) for one in maps)
    assert np.prod(Window.around(shown).size_px) < 0.5 * np.prod(whole.size_px)
    assert small.leaves.volume_mm3() == pytest.approx(large.leaves.volume_mm3(), rel=1e-4)
    assert small.moved_out_mm3 == pytest.approx(large.moved_out_mm3, rel=1e-4)
    assert abs(small.blind_mm3 - large.blind_mm3) < 1e-4 * np.pi * water.radius_mm**2 * (water.top_mm - water.bottom_mm)


def test_a_window_contains_what_may_hide_a_root_but_no_rim() -> None:
    coverage, usable = np.zeros((100, 200), np.float32), np.zeros((100, 200), bool)
    usable[10:90, 20:180], coverage[10:40, 90:100] = True, 1.0
    plain = [Silhouette(coverage, usable)] * 3
    assert Window.around(plain) == Window((82, 6), (26, 42), ((62, 0), (72, 42)))
    speck, rim = usable.copy(), usable.copy()
    speck[60:63, 140:142], rim[:, 20:25] = False, False
    assert Window.around([*plain, Silhouette(coverage, rim)]) == Window.around(plain)
    around = Window.around([*plain, Silhouette(coverage, speck)])
    assert (around.low_px, around.size_px) == ((82, 6), (142 + 8 - 82, 63 + 8 - 6))
