"""The score of balls whose errors are known by hand, and the sentences for what cannot be scored."""

import shutil

import numpy as np
import pytest
import trimesh

from rhizotwin.scenes import frames
from rhizotwin.scenes.errors import UserError
from rhizotwin.scoring import score_views
from rhizotwin.scoring.score import Score, score

RADIUS_MM = 6.0


def scored(made) -> Score:
    return score(made.result, made.dataset)


def test_a_faithful_result_scores_well_everywhere(scan):
    found = scored(scan())
    assert found.volume_error == pytest.approx(0.0, abs=1e-5)
    assert found.extents_error_max < 1e-5
    assert found.extents_true_mm == pytest.approx((12.0, 12.0, 12.0), rel=1e-3)
    assert min(found.voxels.recall, found.voxels.precision) > 0.99
    assert found.voxels.iou_weighted > 0.97
    assert found.surface.median_mm < 1e-5
    assert found.interval_holds_truth
    assert (found.poses.used, found.poses.left_out) == (6, 0)
    assert found.poses.max_mm < 1e-9
    assert (found.masks.iou, found.masks.area_error) == (1.0, 0.0)


@pytest.mark.parametrize("scale", [1.1, 0.9])
def test_a_ball_that_is_too_large_or_too_small(scan, scale):
    found = scored(scan(radius_mm=scale * RADIUS_MM))
    assert found.volume_error == pytest.approx(scale**3 - 1.0, abs=2e-3)
    assert found.extents_error == pytest.approx((scale - 1.0,) * 3, abs=1e-4)
    assert found.voxels.recall == pytest.approx(min(1.0, scale**3), abs=0.01)
    assert found.voxels.precision == pytest.approx(min(1.0, scale**-3), abs=0.01)
    assert found.voxels.iou == pytest.approx(min(scale**3, scale**-3), abs=0.01)
    assert found.hull.recall == pytest.approx(min(1.0, (scale + 0.125 / RADIUS_MM) ** 3), abs=0.01)
    assert (found.surface.median_mm, found.surface.p95_mm) == pytest.approx((0.6, 0.6), abs=0.02)
    assert not found.interval_holds_truth


def test_each_error_is_told_by_its_own_number(scan):
    """A ball 2 mm aside, a frame 0.5 mm aside, silhouettes a tenth too wide, and two views left out."""
    found = scored(scan(shift_mm=(2.0, 0.0, 0.0), found_from_true=frames.translation(0.3, 0.0, 0.4), disk_px=11.0, lost=(2, 3)))
    # two balls of radius r whose centres are d apart share the fraction 1 - 3 d / (4 r) + d^3 / (16 r^3)
    shared = 1.0 - 3.0 * 2.0 / (4.0 * 6.0) + 2.0**3 / (16.0 * 6.0**3)
    assert found.volume_error == pytest.approx(0.0, abs=1e-5)
    assert (found.voxels.recall, found.voxels.precision) == pytest.approx((shared, shared), abs=0.005)
    assert found.voxels.iou == pytest.approx(shared / (2.0 - shared), abs=0.005)
    assert found.surface.p95_mm > 1.5
    assert (found.poses.median_mm, found.poses.common_mm) == pytest.approx((0.5, 0.5))
    assert (found.poses.own_mm, found.poses.median_deg) == pytest.approx((0.0, 0.0), abs=1e-9)
    assert found.masks.area_error == pytest.approx(1.1**2 - 1.0, abs=0.01)
    assert found.masks.iou == pytest.approx(1.1**-2, abs=0.03)
    assert (found.poses.used, found.poses.left_out, len(found.masks.per_view)) == (4, 2, 4)


def empty(made) -> None:
    with np.load(made.result / "shape.npz") as stored:
        content = dict(stored)
    none = {"leaves": np.zeros((0, 3), np.int32), "size": np.zeros(0, np.int32), "occupancy": np.zeros(0, np.float32)}
    np.savez_compressed(made.result / "shape.npz", **(content | none))


def test_mask_errors_by_hand():
    true = np.zeros((4, 6), np.float32)
    true[1:3, 1:5] = 1.0
    found, seen = true.copy(), np.ones(true.shape, bool)
    found[3, 1:5] = 0.5  # 4 half pixels too many
    seen[:, 1] = False  # 2 of 8 true pixels unseen
    # mean error, IoU, error of the area, unseen share
    assert score_views.mask_errors(found, true, seen) == pytest.approx((1.5 / 6.0, 6.0 / 9.0, 1.5 / 6.0, 2.0 / 8.0))


def open_truth(made) -> None:
    path = made.dataset / "truth" / "specimen.ply"
    mesh = trimesh.load(path, process=False)
    path.write_bytes(trimesh.Trimesh(mesh.vertices, mesh.faces[200:], process=False).export(file_type="ply"))


MISTAKES = {
    "no truth": (lambda made: shutil.rmtree(made.dataset / "truth"), "truth"),
    "other scene": (lambda made: made.edit_summary(scene="radish", dataset_sha256="0" * 64), "was not reconstructed from .*radish"),
    "empty shape": (empty, "shape.npz"),
    "open true mesh": (open_truth, "specimen.ply"),
    "no mask": (lambda made: (made.dataset / "truth" / "masks" / "view_002.png").unlink(), "view_002.png"),
}


@pytest.mark.parametrize(("change", "named"), MISTAKES.values(), ids=MISTAKES.keys())
def test_what_cannot_be_scored_is_named(scan, change, named):
    made = scan(voxel_mm=1.0)
    change(made)
    with pytest.raises(UserError, match=named) as caught:
        scored(made)
    assert "\n" not in str(caught.value)
