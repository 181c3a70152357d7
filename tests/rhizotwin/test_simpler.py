"""Surfaces with fewer triangles."""

import numpy as np
import pytest
import trimesh

from rhizotwin.recon.results.parts import Mesh
from rhizotwin.simpler import simpler


def ball(subdivisions: int) -> Mesh:
    return Mesh.of(trimesh.creation.icosphere(subdivisions=subdivisions, radius=20.0))


@pytest.mark.parametrize("most", [2_000, 50_000])
def test_a_ball_stays_a_ball(most: int) -> None:
    found = simpler(ball(7), most)  # 327,680 triangles
    assert 0.4 * most < len(found.faces) <= most
    solid = trimesh.Trimesh(found.vertices_mm, found.faces, process=False)
    assert abs(solid.volume) == pytest.approx(4.0 / 3.0 * np.pi * 20.0**3, rel=0.02)


def test_a_small_surface_stays_as_it_is() -> None:
    mesh = ball(2)
    assert simpler(mesh, len(mesh.faces)) is mesh


def test_triangles_without_an_edge_do_no_harm() -> None:
    mesh = ball(4)
    flat = np.repeat(np.zeros((1, 3), np.int64), 9000, axis=0)
    found = simpler(Mesh(vertices_mm=mesh.vertices_mm, faces=np.concatenate([flat, mesh.faces])), 1000)
    assert 0 < len(found.faces) <= 1000
