"""Tubes and their union against volumes in closed form."""

from itertools import pairwise

import numpy as np
import pytest
import trimesh

from rhizotwin.scenes.rsml import Root
from rhizotwin.scenes.specimens import GrownSpecimen
from rhizotwin.sim import growth, solids
from tests.roots import straight


def tube(line: np.ndarray, diameters_mm: np.ndarray | float) -> Root:
    return Root(points_mm=line, diameters_mm=np.broadcast_to(diameters_mm, len(line)).astype(float), order=0, parent=-1, label="")


def mesh_of(roots: list[Root]) -> trimesh.Trimesh:
    vertices, faces = solids.to_surface(solids.unite_roots(roots))
    return trimesh.Trimesh(vertices, faces, process=False)


@pytest.mark.parametrize("diameter_mm", [0.4, 12.0])
def test_a_tube_has_the_cylinder_s_volume_between_its_caps(diameter_mm: float) -> None:
    """Two lengths: the difference is a cylinder without caps, exact because the polygon's area is the circle's."""
    short = solids.unite_roots([straight((1, 2, -20), (4, 6, -20), diameter_mm)]).volume()
    long = solids.unite_roots([straight((1, 2, -20), (7, 10, -20), diameter_mm)]).volume()
    area_mm2 = np.pi * diameter_mm**2 / 4.0
    assert long - short == pytest.approx(5.0 * area_mm2, rel=1e-9)
    ball_mm3 = np.pi / 6.0 * diameter_mm**3
    assert short == pytest.approx(5.0 * area_mm2 + ball_mm3, abs=0.25 * ball_mm3)


def test_a_tapering_tube_has_the_frustum_s_volume() -> None:
    line = np.linspace((0, 0, -20), (0, 0, -80), 7)
    root = tube(line, np.linspace(4.0, 1.0, 7))
    frustum_mm3 = np.pi * 60.0 / 3.0 * (2.0**2 + 2.0 * 0.5 + 0.5**2)
    caps_mm3 = 2.0 / 3.0 * np.pi * (2.0**3 + 0.5**3)
    assert solids.unite_roots([root]).volume() == pytest.approx(frustum_mm3 + caps_mm3, abs=0.1 * caps_mm3)


def test_crossing_tubes_share_steinmetz_s_solid() -> None:
    """Two cylinders of radius r at right angles share 16 r^3 / 3."""
    r = 4.0
    one, two = straight((-20, 0, -50), (20, 0, -50), 2 * r), straight((0, -20, -50), (0, 20, -50), 2 * r)
    apart = solids.unite_roots([one]).volume() + solids.unite_roots([two]).volume()
    union = solids.unite_roots([one, two]).volume()
    assert apart - union == pytest.approx(16.0 * r**3 / 3.0, rel=0.015)


def test_a_root_that_crosses_itself_counts_the_crossing_once() -> None:
    """A curl that swings back across its first turn, against points drawn at random and their distance to it."""
    turn = np.linspace(0.0, 3.0 * np.pi, 200)
    radius = np.linspace(10.0, 6.0, 200)
    line = np.stack([radius * np.cos(turn), radius * np.sin(turn), np.full(200, -50.0)], axis=1)
    line[150:, 1] += np.linspace(0.0, 12.0, 50)  # swing across the first turn
    root = tube(line, 1.0)
    whole = solids.unite_roots([root])
    naive = solids.to_manifold(*solids.tube(line, np.full(200, 0.5), sides=12))
    mesh = mesh_of([root])
    assert whole.volume() < naive.volume() - 0.3
    assert mesh.is_watertight
    rng = np.random.default_rng(0)
    points = rng.uniform([-12, -12, -50.6], [12, 16, -49.4], (40_000, 3))
    distance = np.full(len(points), np.inf)
    for a, b in pairwise(line):
        part = np.clip((points - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
        distance = np.minimum(distance, np.linalg.norm(points - a - part[:, None] * (b - a), axis=1))
    assert np.mean(distance < 0.5) * 24.0 * 28.0 * 1.2 == pytest.approx(whole.volume(), rel=0.06)


def test_many_tubes_are_united_by_twos(monkeypatch: pytest.MonkeyPatch) -> None:
    roots = [straight((k, 0, -20), (-k, k, -40), 1.0) for k in range(1, 8)]
    whole = solids.unite_roots(roots).volume()
    monkeypatch.setattr(solids, "MOST_AT_ONCE", 3)
    assert solids.unite_roots(roots).volume() == pytest.approx(whole, rel=1e-9)


def test_a_plant_is_scaled_to_its_volume_and_closed() -> None:
    roots = growth.grow(GrownSpecimen(seed=4, age_days=10.0))
    parts_mm3 = sum(solids.unite_roots([root]).volume() for root in roots)
    assert solids.unite_roots(roots).volume() < parts_mm3
    solid, scaled, factor = solids.scale_to_volume(roots, 123.456)
    assert solid.volume() == pytest.approx(123.456, rel=1e-6)
    assert scaled[1].diameters_mm == pytest.approx(factor * roots[1].diameters_mm)
    vertices, faces = solids.to_surface(solid)
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.volume == pytest.approx(123.456, rel=1e-6)
    assert len(solid.decompose()) == 1
