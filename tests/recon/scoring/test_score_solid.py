"""A result against a solid that lies anywhere, and against a volume that was measured."""

import json

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from rhizotwin.recon.results.result_files import Mesh
from rhizotwin.recon.scoring.registration import register
from rhizotwin.recon.scoring.score_solid import score_solid, score_volume
from rhizotwin.scenes import frames
from rhizotwin.scenes.errors import UserError


def forked() -> Mesh:
    """Return three arms of different lengths on a stem: nothing but the identity lays it onto itself."""
    ends = [((0, 0, -10), (0, 0, -80)), ((0, 0, -30), (25, 5, -50)), ((0, 0, -45), (-12, 14, -70)), ((0, 0, -60), (4, -18, -66))]
    parts = []
    for low, high in ends:
        along = np.subtract(high, low).astype(float)
        height = float(np.linalg.norm(along))
        part = trimesh.creation.cylinder(radius=2.0, height=height, sections=24).subdivide()
        part.apply_transform(trimesh.geometry.align_vectors([0, 0, 1], along / height))
        part.apply_translation(np.add(low, high) / 2.0)
        parts.append(part)
    whole = trimesh.util.concatenate(parts)
    return Mesh(vertices_mm=np.asarray(whole.vertices), faces=np.asarray(whole.faces, np.int64))


@pytest.mark.parametrize("seed", range(2))
def test_a_solid_is_laid_where_it_belongs_however_it_lies(seed: int) -> None:
    rng, solid = np.random.default_rng(seed), forked()
    pose = frames.from_rotation_translation(Rotation.random(random_state=seed).as_matrix(), rng.uniform(-200.0, 200.0, 3))
    moved = Mesh(vertices_mm=frames.apply(pose, solid.vertices_mm), faces=solid.faces)
    found = register(moved, solid)
    assert np.abs(found.moved.vertices_mm - solid.vertices_mm).max() < 0.02


def test_what_was_missed_and_what_is_too_much_does_not_pull() -> None:
    solid = forked()
    centres = solid.vertices_mm[solid.faces].mean(axis=1)
    without_an_arm = Mesh(vertices_mm=solid.vertices_mm, faces=solid.faces[centres[:, 0] < 8.0])
    ghost = trimesh.creation.icosphere(subdivisions=2, radius=3.0)
    both = trimesh.util.concatenate(
        trimesh.Trimesh(without_an_arm.vertices_mm, without_an_arm.faces, process=False), ghost.apply_translation([30.0, -20.0, -30.0])
    )
    pose = frames.from_rotation_translation(
        Rotation.from_euler("xyz", [20.0, -35.0, 70.0], degrees=True).as_matrix(), np.array([5.0, 9.0, 40.0])
    )
    found = register(
        Mesh(vertices_mm=frames.apply(pose, solid.vertices_mm), faces=solid.faces),
        Mesh(vertices_mm=np.asarray(both.vertices), faces=np.asarray(both.faces, np.int64)),
    )
    assert np.abs(found.moved.vertices_mm - solid.vertices_mm).max() < 0.1


def test_a_mirror_image_is_not_laid_on() -> None:
    solid = forked()
    mirrored = Mesh(vertices_mm=solid.vertices_mm * [1.0, -1.0, 1.0], faces=solid.faces[:, ::-1])
    found = register(mirrored, solid)
    assert np.linalg.det(found.to_from_solid[:3, :3]) == pytest.approx(1.0)
    assert np.abs(found.moved.vertices_mm - solid.vertices_mm).max() > 5.0


def test_a_ball_that_lies_elsewhere_scores_as_where_it_was(scan) -> None:
    made = scan(radius_mm=6.3)
    truth = trimesh.creation.icosphere(subdivisions=4, radius=6.0)
    far = Mesh(vertices_mm=np.asarray(truth.vertices) + 100.0, faces=np.asarray(truth.faces, np.int64))
    found = score_solid(made.result, far, volume_mm3=float(truth.volume))
    assert found.volume_error == pytest.approx(1.05**3 - 1.0, abs=2e-3)
    assert found.extents_error == pytest.approx((0.05, 0.05, 0.05), abs=2e-3)
    assert found.surface.median_mm == pytest.approx(0.3, abs=0.01)
    assert json.loads(json.dumps(found.to_dict()))["surface"]["median_mm"] == found.surface.median_mm
    assert "laid onto it" in found.table()


def test_a_measured_volume_says_whether_the_interval_holds(scan) -> None:
    made = scan()
    summary = json.loads((made.result / "result.json").read_text())
    low, high = summary["volume_interval_mm3"]
    assert score_volume(made.result, (low + high) / 2.0).interval_holds_truth
    beyond = score_volume(made.result, 1.01 * high)
    assert not beyond.interval_holds_truth
    assert beyond.volume_error == pytest.approx(summary["volume_mm3"] / (1.01 * high) - 1.0)
    assert "misses the truth" in beyond.table()


@pytest.mark.parametrize("volume_mm3", [0.0, -1.0, float("nan"), float("inf")])
def test_a_volume_that_is_none_is_refused(scan, volume_mm3: float) -> None:
    with pytest.raises(UserError, match="above 0"):
        score_volume(scan().result, volume_mm3)
