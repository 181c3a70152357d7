"""Distances to a mesh against brute force over every triangle and against shapes with known distances."""

import numpy as np
import pytest
import trimesh

from rhizotwin.recon import surface_sample
from rhizotwin.scoring import surface_distance


def brute_force(points, mesh):
    best = np.full(len(points), np.inf)
    for triangle in mesh.vertices[mesh.faces]:
        a, b, c = (np.broadcast_to(corner, points.shape) for corner in triangle)
        best = np.minimum(best, surface_distance.point_triangle_distance(points, a, b, c))
    return best


def test_one_triangle_by_hand():
    a, b, c = (0.0, 0.0, 0.0), (4.0, 0.0, 0.0), (0.0, 3.0, 0.0)
    cases = [
        ((1.0, 1.0, 2.0), (a, b, c), 2.0),  # above the face
        ((-3.0, -4.0, 0.0), (a, b, c), 5.0),  # nearest a
        ((2.0, -1.0, 0.0), (a, b, c), 1.0),  # nearest edge ab
        ((4.0, 3.0, 0.0), (a, b, c), 12.0 / 5.0),  # nearest edge bc: height of the 3-4-5 triangle over its hypotenuse
        ((7.0, 0.0, 4.0), (a, b, c), 5.0),  # nearest b
        ((1.0, 2.0, 0.0), (a, b, b), 2.0),  # a segment
        ((1.0, 2.0, 0.0), (a, a, a), np.sqrt(5.0)),  # a point
    ]
    points, corners, expected = (np.array(column) for column in zip(*cases, strict=True))
    assert surface_distance.point_triangle_distance(points, *corners.transpose(1, 0, 2)) == pytest.approx(expected, abs=1e-12)


def test_equals_brute_force_on_triangles_of_very_different_size():
    rng = np.random.default_rng(0)
    fine = trimesh.creation.icosphere(subdivisions=3, radius=1.0)
    coarse = trimesh.creation.box(bounds=[[1.2, -20.0, -20.0], [1.3, 20.0, 30.0]])
    needle = trimesh.creation.cylinder(radius=0.05, height=40.0, sections=8)
    needle.apply_translation([-3.0, 0.0, 0.0])
    mesh = fine + coarse + needle
    points = np.concatenate([rng.normal(0.0, 1.2, (300, 3)), rng.uniform(-30.0, 30.0, (200, 3)), np.zeros((1, 3))])
    found = surface_distance.distances(points, mesh.vertices, mesh.faces)
    assert found == pytest.approx(brute_force(points, mesh), abs=1e-12)


def test_samples_lie_on_the_surface_and_spread_by_area():
    box = trimesh.creation.box(extents=[1.0, 1.0, 10.0])
    points = surface_sample.sample(box.vertices, box.faces, count=4000, rng=np.random.default_rng(0))[0]
    assert surface_distance.distances(points, box.vertices, box.faces).max() < 1e-12
    assert (np.abs(points[:, 2]) > 5.0 - 1e-9).mean() == pytest.approx(2.0 / 42.0, abs=2e-3)
