"""Voxelisation against shapes whose voxels are known, and against a brute-force winding number."""

import numpy as np
import pytest
import trimesh

from rhizotwin.scoring import voxelise

ORIGIN = np.array([-7.3, 1.9, -40.0])
ZERO = np.zeros(3)


def all_indices(mesh, voxel_mm, origin=ZERO):
    low = np.floor((mesh.vertices.min(axis=0) - origin) / voxel_mm).astype(int) - 2
    high = np.ceil((mesh.vertices.max(axis=0) - origin) / voxel_mm).astype(int) + 2
    return np.argwhere(np.ones(high - low, bool)) + low


def winding(mesh, points):
    """Solid-angle winding number (van Oosterom and Strackee 1983), the slow reference."""
    total = np.zeros(len(points))
    for triangle in mesh.vertices[mesh.faces]:
        a, b, c = (corner - points for corner in triangle)
        la, lb, lc = (np.linalg.norm(x, axis=1) for x in (a, b, c))
        triple = np.einsum("ij,ij->i", a, np.cross(b, c))
        dots = np.einsum("ij,ij->i", a, b) * lc + np.einsum("ij,ij->i", b, c) * la + np.einsum("ij,ij->i", c, a) * lb
        total += 2.0 * np.arctan2(triple, la * lb * lc + dots)
    return total / (4.0 * np.pi)


def occupied_at(mesh, indices, voxel_mm, origin=ZERO):
    """Whether the centre of each voxel (N, 3) lies inside."""
    one = np.ones(len(indices), np.int64)
    return voxelise.count_in_boxes(mesh.vertices, mesh.faces, indices, one, origin_mm=origin, voxel_mm=voxel_mm) > 0


@pytest.fixture(scope="module")
def blob():
    mesh = trimesh.creation.icosphere(subdivisions=2, radius=3.0)
    rng = np.random.default_rng(3)
    mesh.vertices = mesh.vertices * rng.uniform(0.6, 1.3, (len(mesh.vertices), 1)) + [1.0, 2.0, -30.0]
    return mesh


def test_agrees_with_the_winding_number_of_a_jagged_blob(blob):
    indices = all_indices(blob, 0.5, ORIGIN)
    expected = np.abs(winding(blob, ORIGIN + 0.5 * (indices + 0.5))) > 0.5
    assert 300 < expected.sum() < len(indices) - 300
    assert np.array_equal(occupied_at(blob, indices, 0.5, ORIGIN), expected)
    assert voxelise.cross_columns(blob.vertices, blob.faces, origin_mm=ORIGIN, voxel_mm=0.5).count == expected.sum()
    assert voxelise.count_inside(blob.vertices, blob.faces, origin_mm=ORIGIN, voxel_mm=0.5) == expected.sum()


def test_faces_and_edges_through_voxel_centres_are_counted_once():
    # Corners of the box, its faces and the diagonals of its faces all pass exactly through centres (integers plus a half).
    box = trimesh.creation.box(bounds=[[0.5, 0.5, 0.5], [4.5, 4.5, 4.5]])
    indices = all_indices(box, 1.0)
    found = occupied_at(box, indices, 1.0)
    assert found.sum() == 4**3
    assert np.ptp(indices[found], axis=0).tolist() == [3, 3, 3]
    # A fan round (0, 0): the vertical ray through a centre hits a vertex of many triangles.
    fan = trimesh.creation.icosphere(subdivisions=3, radius=5.0).apply_translation([0.5, 0.5, 0.5])
    count = voxelise.count_inside(fan.vertices, fan.faces, origin_mm=ZERO, voxel_mm=0.25)
    assert count * 0.25**3 == pytest.approx(fan.volume, rel=3e-3)


def test_overlapping_and_inverted_solids():
    one = trimesh.creation.icosphere(subdivisions=3, radius=2.0)
    two = one.copy().apply_translation([1.0, 0.1, 0.2])
    inverted = trimesh.Trimesh(one.vertices, one.faces[:, ::-1], process=False)
    indices = all_indices(one + two, 0.3)
    a, b, union, same = (occupied_at(mesh, indices, 0.3) for mesh in (one, two, one + two, inverted))
    assert np.array_equal(union, a | b)
    assert np.array_equal(same, a)


def test_boxes_count_their_voxels(blob):
    rng = np.random.default_rng(5)
    low, size = rng.integers([8, -18, 15], [42, 14, 48], (300, 3)), rng.integers(1, 9, 300)
    counts = voxelise.count_in_boxes(blob.vertices, blob.faces, low, size, origin_mm=ORIGIN, voxel_mm=0.3)
    voxels = np.concatenate([corner + np.argwhere(np.ones((edge,) * 3, bool)) for corner, edge in zip(low, size, strict=True)])
    inside = occupied_at(blob, voxels, 0.3, ORIGIN)
    np.testing.assert_array_equal(counts, np.bincount(np.repeat(np.arange(300), size**3), weights=inside))
    assert 20 < np.count_nonzero(counts) < 280
