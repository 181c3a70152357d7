"""Views that contradict all others, among exact silhouettes of a plant of rods."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.spatial import cKDTree

from rhizotwin.recon.coverage.silhouettes import Silhouette, Window
from rhizotwin.recon.hull import agreement
from rhizotwin.recon.hull.boxes import CellSet
from rhizotwin.recon.hull.carve import Water, carve
from rhizotwin.recon.hull.distance_maps import DistanceMaps
from rhizotwin.recon.hull.leaves import Hull, Leaves
from rhizotwin.recon.optics.projection import ViewBank
from rhizotwin.recon.optics.refraction import Optics
from rhizotwin.scenes.monitor import Monitor
from rhizotwin.scoring.regularised_hull import regularise
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
        (lambda one: below(one, 1.0), [WRONG], [WRONG]),
        (lambda one: below(one, 0.0), [0, WRONG], [0, WRONG]),
        (mirrored, [0, 1, 2, 3, 4, 5], []),
    ],
    ids=["none", "mirrored", "dark below", "two without roots below", "too many to be named"],
)
def test_wrong_views_are_found(spoil: Callable[[Silhouette], Silhouette], wrong: list[int], named: list[int]) -> None:
    bank, silhouettes, water = scan()
    spoilt = [spoil(one) if k in wrong else one for k, one in enumerate(silhouettes)]
    assert sorted(agreement.find_wrong_views(bank, spoilt, water)) == named


SIZE_MM = 0.5


def mended(silhouettes: Sequence[Silhouette]) -> tuple[Leaves, Leaves]:
    """Return a carved shape, and the same regularised."""
    bank, _, water = scan()
    maps = DistanceMaps.compute(silhouettes, "outlines", Monitor.of(None))
    hull = carve(bank, maps, water.grid(SIZE_MM), water, slack_px=2.0, min_votes=bank.count)
    return hull.leaves.select(hull.leaves.occupancy >= 0.5), regularise(bank, silhouettes, hull)


def parts(leaves: Leaves) -> int:
    return int(CellSet.from_cells(leaves.split().index).components().max()) + 1


def found_share(leaves: Leaves) -> float:
    """Return the share of the rods' centre lines within a voxel of the shape."""
    lines = np.concatenate([np.linspace(a, b, 100) for a, b, _ in RODS])
    middles = leaves.grid.origin_mm + (leaves.split().index + 0.5) * SIZE_MM
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
    kept, every = ({tuple(cell) for cell in made.split().index.tolist()} for made in (before, after))
    assert kept <= every


def test_a_whole_shape_stays_nearly_as_it_is() -> None:
    before, after = mended(scan()[1])
    assert after.volume_mm3() == pytest.approx(before.volume_mm3(), rel=0.1)
    nothing = before.select(slice(0))
    assert len(regularise(*scan()[:2], Hull(nothing, nothing.occupancy, 0.0, 0.0)).size) == 0


def test_a_window_around_roots_carves_the_same_as_whole_pictures() -> None:
    bank, shown, water = scan()
    whole = Window((0, 0), shown[0].coverage.shape[::-1])
    maps = (DistanceMaps.compute(shown, "outlines", Monitor.of(None), window=window) for window in (Window.around(shown), whole))
    small, large = (carve(bank, one, water.grid(0.5), water) for one in maps)
    assert np.prod(Window.around(shown).size_px) < 0.5 * np.prod(whole.size_px)
    assert small.leaves.volume_mm3() == pytest.approx(large.leaves.volume_mm3(), rel=1e-4)
    assert small.moved_out_mm3 == pytest.approx(large.moved_out_mm3, rel=1e-4)
    assert abs(small.blind_mm3 - large.blind_mm3) < 1e-4 * np.pi * water.radius_mm**2 * (water.top_mm - water.bottom_mm)
