"""Cubes placed by the blocks in which they lie, against cubes that are followed through the water one by one."""

import drjit as dr
import mitsuba as mi
import numpy as np

from rhizotwin.recon import device
from rhizotwin.recon.hull.blocks import Blocks
from rhizotwin.recon.hull.leaves import Grid
from rhizotwin.recon.optics import projection
from tests.recon.strings import cameras


def test_cubes_lie_where_they_are_projected() -> None:
    bank, _ = cameras()
    grid = Grid(np.array([-40.0, -40.0, -60.0]), 0.14, 0, (600, 600, 300))
    index, edge = 2 * np.random.default_rng(3).integers(0, 150, (2000, 3)) + np.array([150, 150, 0]), 2
    placed = Blocks.of(bank, grid, index, edge)
    lane = dr.arange(mi.UInt32, bank.count * len(index))
    view, cube = lane // len(index), lane % len(index)
    px, du, _, seen = placed.at(view, cube)
    middle_mm = device.points(np.asarray(grid.origin_mm) + (index + 0.5 * edge) * grid.size_mm)
    p = projection.project(bank, view, dr.gather(mi.Point3f, middle_mm, cube), mi.Bool(True))
    both = np.array(seen & p.seen)
    assert both.mean() > 0.9
    assert np.abs(np.array(px - p.px))[:, both].max() < 0.01
    np.testing.assert_allclose(np.array(du)[:, both], np.array(p.du)[:, both], atol=0.02)
