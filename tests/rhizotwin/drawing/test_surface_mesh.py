"""Surfaces for display and export: closed whatever touches or is missing, without specks, with few triangles."""

import io

import numpy as np
import pytest
import trimesh

from rhizotwin.drawing import surface_mesh
from rhizotwin.recon.results.parts import Mesh


def ball(subdivisions: int, radius: float = 20.0) -> Mesh:
    return Mesh.of(trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius))


def joined(*parts: Mesh) -> Mesh:
    first = np.cumsum([0, *(len(part.vertices_mm) for part in parts[:-1])])
    faces = np.concatenate([part.faces + start for part, start in zip(parts, first, strict=True)])
    return Mesh(vertices_mm=np.concatenate([part.vertices_mm for part in parts]), faces=faces)


def solid(mesh: Mesh) -> trimesh.Trimesh:
    """Return a surface as it comes back from an STL file, which has no shared vertices."""
    written = trimesh.Trimesh(mesh.vertices_mm, mesh.faces, process=False).export(file_type="stl")
    return trimesh.load_mesh(io.BytesIO(written), file_type="stl")


def cube(low: tuple[float, float, float]) -> Mesh:
    made = trimesh.creation.box((10.0, 10.0, 10.0))
    made.apply_translation(np.array(low) + 5.0)
    return Mesh.of(made)


@pytest.mark.parametrize("shift", [(10.0, 10.0, 0.0), (10.0, 10.0, 10.0)], ids=["edge", "corner"])
def test_cubes_that_touch_are_two_closed_surfaces(shift: tuple[float, float, float]) -> None:
    touching = joined(cube((0.0, 0.0, 0.0)), cube(shift))
    assert solid(touching).is_watertight == (shift[2] > 0.0)  # an edge with four triangles is no surface
    found = solid(surface_mesh.close(touching))
    assert found.is_watertight
    assert found.body_count == 2
    assert found.volume == pytest.approx(2000.0, rel=5e-3)


def test_cubes_that_share_a_side_become_one() -> None:
    below = cube((0.0, 0.0, 0.0))
    above = Mesh(vertices_mm=below.vertices_mm * [1.0, 1.0, -1.0], faces=below.faces[:, ::-1])
    found = solid(surface_mesh.close(joined(below, above)))
    assert found.body_count == 1
    assert found.is_watertight
    assert found.volume == pytest.approx(2000.0, rel=1e-6)


def test_holes_are_closed() -> None:
    mesh = ball(4)
    above = mesh.vertices_mm[mesh.faces][:, :, 2].max(axis=1) < 18.0
    found = solid(surface_mesh.close(Mesh(vertices_mm=mesh.vertices_mm, faces=mesh.faces[above][5:])))
    assert found.is_watertight
    assert found.volume == pytest.approx(4.0 / 3.0 * np.pi * 20.0**3, rel=0.02)


def test_specks_go_and_small_roots_stay() -> None:
    speck, root = ball(1, 0.4), trimesh.creation.cylinder(radius=0.2, height=8.0)
    speck = Mesh(vertices_mm=speck.vertices_mm + np.array([30.0, 0.0, 0.0]), faces=speck.faces)
    root.apply_translation((-30.0, 0.0, 0.0))
    found = solid(surface_mesh.close(joined(ball(3), speck, Mesh.of(root))))
    assert found.body_count == 2
    assert found.bounds[0, 0] < -30.0


@pytest.mark.parametrize("most", [2_000, 50_000])
def test_a_ball_stays_a_ball(most: int) -> None:
    found = surface_mesh.simplify(ball(6), most)  # 81,920 triangles
    assert 0.2 * most < len(found.faces) <= most
    made = solid(found)
    assert made.is_watertight
    assert made.volume == pytest.approx(4.0 / 3.0 * np.pi * 20.0**3, rel=2e-3)
    assert np.linalg.norm(found.vertices_mm, axis=1) == pytest.approx(20.0, abs=0.2)


def test_degenerate_missing_and_few_triangles_do_no_harm() -> None:
    mesh = ball(4)
    assert surface_mesh.simplify(mesh, len(mesh.faces)) is mesh
    flat = np.repeat(np.zeros((1, 3), np.int64), 9000, axis=0)
    found = surface_mesh.close(Mesh(vertices_mm=mesh.vertices_mm, faces=np.concatenate([flat, mesh.faces])))
    assert 0 < len(surface_mesh.simplify(found, 1000).faces) <= 1000
    empty = Mesh(vertices_mm=np.zeros((0, 3)), faces=np.zeros((0, 3), np.int64))
    assert surface_mesh.simplify(surface_mesh.close(empty), 10) is empty


def test_the_nearest_root_has_the_nearest_surface() -> None:
    thick, thin = np.array([[0.0, 0.0, z] for z in range(20)]), np.array([[8.0, 0.0, float(z)] for z in range(20)])
    radii = np.repeat([5.0, 0.2], 20)
    found = surface_mesh.nearest_root(np.array([[5.0, 0.0, 7.0], [7.8, 0.0, 7.0]]), np.concatenate([thick, thin]), radii)
    assert list(found) == [7, 27]
