"""The regularised visual hull mends what shifted pictures cut, and leaves a whole shape as it is."""

from dataclasses import replace

import numpy as np
import pytest

from rhizotwin.recon.coverage.silhouettes import Silhouette
from rhizotwin.recon.hull import agreement
from rhizotwin.recon.hull.boxes import CellSet
from rhizotwin.recon.hull.carve import carve
from rhizotwin.recon.hull.distance_maps import DistanceMaps
from rhizotwin.recon.hull.leaves import Hull, Leaves, to_unit_cubes
from rhizotwin.recon.hull.regularised import regularise
from rhizotwin.scenes.monitor import Monitor
from tests.recon.hull.test_agreement import RODS, scan

SIZE_MM = 0.5


def carved(silhouettes: list[Silhouette]) -> Hull:
    bank, _, water = scan()
    maps = DistanceMaps.compute(silhouettes, "outlines", Monitor.of(None))
    return carve(bank, maps, water.grid(SIZE_MM), water, slack_px=2.0, ignore_blindness=True)


def shifted(px: int) -> list[Silhouette]:
    """Move every other picture sideways, as poses that are off do."""
    rng = np.random.default_rng(5)
    return [replace(one, coverage=np.roll(one.coverage, int(px * rng.integers(-1, 2)), axis=1)) for one in scan()[1]]


def strict(hull: Hull) -> Leaves:
    return hull.leaves.select(hull.leaves.occupancy >= 0.5)


def parts(leaves: Leaves) -> int:
    return int(CellSet.from_cells(to_unit_cubes(leaves.index, leaves.size)).components().max()) + 1


def found_share(leaves: Leaves) -> float:
    """Return the share of the rods' centre lines within a voxel of the shape."""
    lines = np.concatenate([np.linspace(a, b, 100) for a, b, _ in RODS])
    middles = leaves.grid.origin_mm + (to_unit_cubes(leaves.index, leaves.size) + 0.5) * SIZE_MM
    return float(np.mean([np.linalg.norm(middles - point, axis=1).min() < 2.0 * SIZE_MM for point in lines]))


def test_parts_that_shifted_pictures_cut_are_joined_and_one_picture_is_covered() -> None:
    silhouettes = shifted(1)
    hull, bank = carved(silhouettes), scan()[0]
    before, after = strict(hull), regularise(bank, silhouettes, hull)
    assert parts(before) > 1
    assert parts(after) == 1
    assert found_share(before) < 0.5
    assert found_share(after) > 0.8
    reference = int(np.argmax([one.coverage[one.usable].sum() for one in silhouettes]))
    missed = [
        agreement.missed_pixels(bank.select([reference]), silhouettes[reference], one.middles_mm, SIZE_MM * one.size.astype(float)).sum()
        for one in (before, after)
    ]
    assert missed[1] < 0.1 * missed[0]
    kept = {tuple(cell) for cell in to_unit_cubes(before.index, before.size).tolist()}
    assert kept <= {tuple(cell) for cell in to_unit_cubes(after.index, after.size).tolist()}


def test_a_whole_shape_stays_nearly_as_it_is() -> None:
    silhouettes = list(scan()[1])
    hull = carved(silhouettes)
    before, after = strict(hull), regularise(scan()[0], silhouettes, hull)
    assert after.volume_mm3() == pytest.approx(before.volume_mm3(), rel=0.1)


def test_nothing_to_mend_is_no_error() -> None:
    bank, silhouettes, _ = scan()
    hull = carved(list(silhouettes))
    nothing = hull.leaves.select(np.zeros(len(hull.leaves.size), bool))
    assert len(regularise(bank, silhouettes, Hull(nothing, nothing.occupancy, 0.0, 0.0)).size) == 0
