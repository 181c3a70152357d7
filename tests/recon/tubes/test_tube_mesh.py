"""Surface of thick parts and thin tubes: closed, with the volume of the roots, also where occupancies are at the level of the surface."""

import numpy as np
import pytest

from rhizotwin.recon.hull import surface
from rhizotwin.recon.hull.leaves import Grid
from rhizotwin.recon.tubes.tube_mesh import mesh_parts
from rhizotwin.recon.tubes.tubes import Tubes
from tests.recon.hull.blocks import block


def tree() -> Tubes:
    """Return a taproot that tapers from 1 to 0.1 mm, with a lateral of 0.1 mm that begins at its axis."""
    way = np.linspace(0.0, 30.0, 61)
    tap = np.stack([0.0 * way, 0.0 * way, -way], axis=1)
    lateral = np.array([[0.5 * k, 0.0, -20.0] for k in range(1, 31)])
    radius = np.concatenate([np.interp(way, [0.0, 30.0], [1.0, 0.1]), np.full(30, 0.1)])
    return Tubes(np.concatenate([tap, lateral]), radius, (np.arange(61), np.concatenate([[40], np.arange(61, 91)])))


def test_union_has_the_volume_of_the_roots() -> None:
    """Taproot and lateral end round; 0.4 mm of the lateral are inside the taproot, whose radius is 0.4 mm there."""
    mesh = surface.unite(mesh_parts(tree(), np.ones(91, bool)))
    taproot_mm3 = np.pi * 30.0 / 3.0 * (1.0 + 0.1 + 0.01)
    assert mesh.is_watertight
    tips_mm3 = 2.0 * 2.0 / 3.0 * np.pi * 0.001
    assert mesh.volume == pytest.approx(taproot_mm3 + np.pi * 0.01 * (15.0 - 0.4) + tips_mm3, rel=2e-3)
    assert mesh.bounds[0][2] == pytest.approx(-30.1, abs=0.003)


def test_parts_end_one_node_beyond_the_mask() -> None:
    thin = tree().radius_mm < 0.5
    parts = list(mesh_parts(tree(), thin))
    first = np.flatnonzero(thin)[0] - 1
    assert [len(vertices) // 12 for vertices, _ in parts] == [61 + 3 - first, 31 + 3]
    assert parts[0][0][:, 2].max() == pytest.approx(-0.5 * first)
    assert list(mesh_parts(tree(), np.zeros(91, bool))) == []


@pytest.mark.parametrize("levels", [(0.5,), (0.25, 0.5, 0.75, 1.0), (0.5000001, 0.4999999)])
def test_surface_is_closed_at_every_occupancy(levels: tuple[float, ...]) -> None:
    rng = np.random.default_rng(3)
    index = np.unique(rng.integers(0, 12, (900, 3)), axis=0).astype(np.int32)
    occupancy = rng.choice(levels, len(index)).astype(np.float32)
    mesh = surface.surface(block(Grid(np.zeros(3), 0.27, 0, (12, 12, 12)), index, occupancy))
    united = surface.unite([(np.asarray(mesh.vertices), np.asarray(mesh.faces))])
    assert united.is_watertight
    assert united.volume == pytest.approx(mesh.volume)
    assert not len(surface.unite([]).faces)
