"""A result against a solid that lies anywhere, and against a volume that was measured."""

import json
from functools import cache

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from rhizotwin.recon.results.parts import Mesh
from rhizotwin.scenes import frames
from rhizotwin.scenes.errors import UserError
from rhizotwin.scoring.registration import register
from rhizotwin.scoring.score_solid import score_solid, score_volume


def mesh_of(solid: trimesh.Trimesh) -> Mesh:
    return Mesh(vertices_mm=np.asarray(solid.vertices), faces=np.asarray(solid.faces, np.int64))


@cache
def forked() -> Mesh:
    """Return three arms of different lengths on a stem: nothing but the identity lays it onto itself."""
    ends = [((0, 0, -10), (0, 0, -80)), ((0, 0, -30), (25, 5, -50)), ((0, 0, -45), (-12, 14, -70)), ((0, 0, -60), (4, -18, -66))]
    return mesh_of(trimesh.util.concatenate([trimesh.creation.cylinder(2.0, segment=segment, sections=24).subdivide() for segment in ends]))


def test_a_solid_is_laid_where_it_belongs_despite_errors() -> None:
    solid = forked()
    pose = frames.from_rotation_translation(Rotation.random(random_state=1).as_matrix(), np.array([150.0, -90.0, 40.0]))
    moved = Mesh(vertices_mm=frames.apply(pose, solid.vertices_mm), faces=solid.faces)
    assert np.abs(register(moved, solid).moved.vertices_mm - solid.vertices_mm).max() < 0.02
    kept = solid.faces[solid.vertices_mm[solid.faces].mean(axis=1)[:, 0] < 8.0]
    ghost = trimesh.creation.icosphere(subdivisions=2, radius=3.0).apply_translation([30.0, -20.0, -30.0])
    other = trimesh.util.concatenate(trimesh.Trimesh(solid.vertices_mm, kept, process=False), ghost)
    assert np.abs(register(moved, mesh_of(other)).moved.vertices_mm - solid.vertices_mm).max() < 0.1


def test_a_mirror_image_is_not_laid_on() -> None:
    solid = forked()
    mirrored = Mesh(vertices_mm=solid.vertices_mm * [1.0, -1.0, 1.0], faces=solid.faces[:, ::-1])
    found = register(mirrored, solid)
    assert np.linalg.det(found.to_from_solid[:3, :3]) == pytest.approx(1.0)
    assert np.abs(found.moved.vertices_mm - solid.vertices_mm).max() > 5.0


def test_a_ball_that_lies_elsewhere_scores_as_where_it_was(scan) -> None:
    made = scan(radius_mm=6.3)
    far = trimesh.creation.icosphere(subdivisions=4, radius=6.0).apply_translation([100.0, 100.0, 100.0])
    found = score_solid(made.result, mesh_of(far), volume_mm3=float(far.volume))
    assert found.volume_error == pytest.approx(1.05**3 - 1.0, abs=2e-3)
    assert found.extents_error == pytest.approx((0.05, 0.05, 0.05), abs=2e-3)
    assert found.surface.median_mm == pytest.approx(0.3, abs=0.01)
    assert json.loads(json.dumps(found.to_dict()))["surface"]["median_mm"] == found.surface.median_mm
    assert "registered solid" in found.table()
    with pytest.raises(UserError, match="probably in cm instead of mm"):
        score_solid(made.result, mesh_of(far.apply_scale(0.1)), volume_mm3=float(far.volume))


def test_a_measured_volume_says_whether_the_interval_holds(scan) -> None:
    made = scan()
    summary = json.loads((made.result / "result.json").read_text())
    low, high = summary["volume_interval_mm3"]
    assert score_volume(made.result, (low + high) / 2.0).interval_holds_truth
    beyond = score_volume(made.result, 1.01 * high)
    assert not beyond.interval_holds_truth
    assert beyond.volume_error == pytest.approx(summary["volume_mm3"] / (1.01 * high) - 1.0)
    assert "does not contain the true volume" in beyond.table()
    with pytest.raises(UserError, match="must be positive"):
        score_volume(made.result, 0.0)
