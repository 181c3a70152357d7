"""Two plants in one canister are found, though tracing and fitting know one tree."""

from dataclasses import replace

import numpy as np
import pytest

from rhizotwin.recon.coverage.evidence import Evidence
from rhizotwin.recon.coverage.silhouettes import Silhouette
from rhizotwin.recon.hull.carve import Water
from rhizotwin.recon.roots import crown, plants, rooting
from rhizotwin.recon.tubes.tubes import SPACING_MM
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.monitor import Monitor
from rhizotwin.scenes.plants import Plant
from rhizotwin.scenes.rsml import length_mm, plant_roots
from tests.recon.strings import line, pictured, standing, strung

A, B = Plant(plant="A", at_mm=(-12.0, 0.0)), Plant(plant="B", at_mm=(12.0, 0.0))
GRID_MM = -8.0


def paths(plant: Plant) -> list[np.ndarray]:
    """Return a taproot and two laterals, one towards the other plant."""
    x, side = plant.at_mm[0], float(np.sign(plant.at_mm[0]))
    taproot = line((x, 0.0, -11.0), (x, 0.0, -45.0))
    return [taproot, line((x, 0.0, -20.0), (x - side * 9, 3.0, -32.0)), line((x, 0.0, -26.0), (x + side * 6, -4.0, -38.0))]


def test_both_plants_are_found_each_with_its_roots() -> None:
    true = {plant.plant: strung(*paths(plant), radius_mm=0.3) for plant in (A, B)}
    pictures = [pictured(one) for one in true.values()]
    lowest_row = pictures[0].project(np.array([[0.0, 0.0, -10.0]])).px[:, 0, 1]  # above it the net pot hides all
    coverage = np.maximum(*(np.array([one.coverage for one in picture.silhouettes]) for picture in pictures))
    seen = np.broadcast_to(np.arange(coverage.shape[1])[:, None] > lowest_row[:, None, None], coverage.shape)
    drawn = [Silhouette(one, told) for one, told in zip(np.where(seen, coverage, 0.0).astype(np.float32), seen.copy(), strict=True)]
    scene = replace(Scene(), plants=(A, B))
    tops = crown.tops(scene)
    assert all(scene.net_pot.grid_z_mm < z < scene.net_pot.top_mm for _, _, z in tops)
    assert crown.tops(replace(scene, plants=(A,))) == ()
    evidence = replace(Evidence.from_silhouettes(pictures[0].bank, drawn), tops_mm=tops)
    tree = rooting.find_tree(evidence, standing(), Water(35.0, GRID_MM, -60.0), None, monitor=Monitor())
    assert tree is not None
    system = crown.mark_hidden(rooting.finish_tree(tree, monitor=Monitor()), GRID_MM)
    given = plants.assign(system.roots(), (A, B), grid_z_mm=GRID_MM)
    assert not given.missing
    own = [plant_roots(given.roots, plant.plant) for plant in (A, B)]
    assert [[root.order for root in roots] for roots in own] == [[0, 1, 1]] * 2
    begin = [roots[0].points_mm[0] for roots in own]
    np.testing.assert_allclose(begin, [[*plant.at_mm, -11.0] for plant in (A, B)], atol=1.5 * SPACING_MM)  # the crown is no root
    assert [length_mm(roots) for roots in own] == pytest.approx([one.length_mm for one in true.values()], rel=0.02)
    assert [np.median(roots[1].diameters_mm) for roots in own] == pytest.approx([0.6, 0.6], rel=0.05)
