"""The score of balls whose errors are known by hand, and the sentences for what cannot be scored."""

import json

import numpy as np
import pytest

from rhizotwin.recon.scoring import score_views
from rhizotwin.recon.scoring.score import score
from rhizotwin.scenes import frames
from rhizotwin.scenes.errors import UserError

RADIUS_MM = 6.0


def test_a_faithful_result_scores_well_everywhere(scan):
    made = scan()
    found = score(made.result, made.dataset)
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


def test_a_swollen_ball_has_full_recall_and_low_precision(scan):
    made = scan(radius_mm=1.1 * RADIUS_MM)
    found = score(made.result, made.dataset)
    assert found.volume_error == pytest.approx(1.1**3 - 1.0, abs=2e-3)
    assert found.extents_error == pytest.approx((0.1, 0.1, 0.1), abs=1e-4)
    assert found.voxels.recall == 1.0
    assert found.voxels.precision == pytest.approx(1.1**-3, abs=0.01)
    assert found.voxels.iou == pytest.approx(1.1**-3, abs=0.01)
    assert found.surface.median_mm == pytest.approx(0.6, abs=0.02)
    assert found.surface.p95_mm == pytest.approx(0.6, abs=0.02)
    assert not found.interval_holds_truth


def test_a_shrunken_ball_is_the_other_way_round(scan):
    made = scan(radius_mm=0.9 * RADIUS_MM)
    found = score(made.result, made.dataset)
    assert found.volume_error == pytest.approx(0.9**3 - 1.0, abs=2e-3)
    assert found.voxels.precision == 1.0
    assert found.voxels.recall == pytest.approx(0.9**3, abs=0.01)
    assert found.hull.recall == pytest.approx(((0.9 * 6.0 + 0.125) / 6.0) ** 3, abs=0.01)


def test_a_shifted_ball_has_no_volume_error_but_is_not_where_it_should_be(scan):
    made = scan(shift_mm=(2.0, 0.0, 0.0))
    found = score(made.result, made.dataset)
    # Two balls of radius r whose centres are d apart share the fraction 1 - 3 d / (4 r) + d^3 / (16 r^3).
    shared = 1.0 - 3.0 * 2.0 / (4.0 * 6.0) + 2.0**3 / (16.0 * 6.0**3)
    assert found.volume_error == pytest.approx(0.0, abs=1e-5)
    assert found.voxels.recall == pytest.approx(shared, abs=0.005)
    assert found.voxels.precision == pytest.approx(shared, abs=0.005)
    assert found.voxels.iou == pytest.approx(shared / (2.0 - shared), abs=0.005)
    assert found.surface.p95_mm > 1.5


def test_large_leaves_count_as_their_voxels(scan):
    made = scan(voxel_mm=0.25)
    before = score(made.result, made.dataset)
    with np.load(made.result / "shape.npz") as stored:
        content = dict(stored)
    parent, member = np.unique(content["leaves"] // 2, axis=0, return_inverse=True)
    full = np.bincount(member.ravel(), weights=content["occupancy"]) == 8.0
    assert full.sum() > 100
    alone = ~full[member.ravel()]
    merged = {
        "leaves": np.concatenate([content["leaves"][alone], parent[full].astype(np.int32) * 2]),
        "size": np.concatenate([content["size"][alone], np.full(full.sum(), 2, np.int32)]),
        "occupancy": np.concatenate([content["occupancy"][alone], np.ones(full.sum(), np.float32)]),
    }
    np.savez_compressed(made.result / "shape.npz", **(content | merged))
    after = score(made.result, made.dataset)
    assert after.voxels.recall == before.voxels.recall
    assert after.voxels.precision == before.voxels.precision
    assert after.hull.volume_mm3 == pytest.approx(before.hull.volume_mm3)
    assert after.voxels.iou_weighted == pytest.approx(before.voxels.iou_weighted, abs=1e-4)


def test_a_common_shift_of_the_frame_is_told_from_errors_of_single_views(scan):
    found_from_true = frames.translation(0.3, 0.0, 0.4)
    found = score((made := scan(found_from_true=found_from_true)).result, made.dataset)
    assert found.poses.median_mm == pytest.approx(0.5)
    assert found.poses.common_mm == pytest.approx(0.5)
    assert found.poses.own_mm == pytest.approx(0.0, abs=1e-9)
    assert found.poses.median_deg == pytest.approx(0.0, abs=1e-9)


def test_a_turned_frame_shows_as_an_angle(scan):
    made = scan(found_from_true=frames.rotation_z(np.deg2rad(0.2)))
    found = score(made.result, made.dataset)
    assert found.poses.median_deg == pytest.approx(0.2)
    assert found.poses.common_deg == pytest.approx(0.2)
    assert found.poses.median_mm == pytest.approx(2.0 * 400.0 * np.sin(np.deg2rad(0.1)), rel=1e-6)


def test_left_out_views_are_counted_and_not_scored(scan):
    made = scan(lost=(2, 3))
    found = score(made.result, made.dataset)
    assert (found.poses.used, found.poses.left_out) == (4, 2)
    assert len(found.masks.per_view) == 4


def test_mask_errors_by_hand():
    true = np.zeros((4, 6), np.float32)
    true[1:3, 1:5] = 1.0
    found = true.copy()
    found[3, 1:5] = 0.5  # 4 half pixels too many
    seen = np.ones(true.shape, bool)
    seen[:, 1] = False  # 2 of 8 true pixels unseen
    mean_abs, iou, area_error, unseen = score_views.mask_errors(found, true, seen)
    assert mean_abs == pytest.approx(1.5 / 6.0)
    assert iou == pytest.approx(6.0 / 9.0)
    assert area_error == pytest.approx(1.5 / 6.0)
    assert unseen == pytest.approx(2.0 / 8.0)


def test_silhouettes_a_tenth_too_wide(scan):
    made = scan(disk_px=11.0)
    found = score(made.result, made.dataset)
    assert found.masks.area_error == pytest.approx(1.1**2 - 1.0, abs=0.01)
    assert found.masks.iou == pytest.approx(1.1**-2, abs=0.03)


def test_json_and_table_say_the_same(scan):
    made = scan(radius_mm=1.02 * RADIUS_MM, lost=(1,))
    found = score(made.result, made.dataset)
    stored = json.loads(json.dumps(found.to_dict(), allow_nan=False))
    for key in ("volume_mm3", "volume_true_mm3", "volume_error", "extents_error", "recall", "precision", "iou", "timings_s"):
        assert key in stored
    assert stored["extents_error"] == pytest.approx([0.02] * 3, abs=1e-3)
    text = found.table()
    assert f"{100.0 * stored['volume_error']:+.2f} %" in text
    assert f"IoU {stored['iou']:.4f}" in text
    assert "5 used, 1 left out" in text
    assert "warning: view 3 is <dark>" in text


def _remove_truth(made):
    import shutil

    shutil.rmtree(made.dataset / "truth")


def _damage(name):
    def change(made):
        path = (made.result if not name.startswith("truth") else made.dataset) / name
        path.write_bytes(path.read_bytes()[:40])

    return change


def _empty(made):
    with np.load(made.result / "shape.npz") as stored:
        content = dict(stored)
    none = {"leaves": np.zeros((0, 3), np.int32), "size": np.zeros(0, np.int32), "occupancy": np.zeros(0, np.float32)}
    np.savez_compressed(made.result / "shape.npz", **(content | none))


def _other_frame(made):
    views = json.loads((made.result / "result.json").read_text())["views"]
    views[0]["file"] = "images/elsewhere.png"
    made.edit_summary(views=views)


def _open_truth(made):
    import trimesh

    path = made.dataset / "truth" / "specimen.ply"
    mesh = trimesh.load(path, process=False)
    path.write_bytes(trimesh.Trimesh(mesh.vertices, mesh.faces[200:], process=False).export(file_type="ply"))


MISTAKES = {
    "no truth": (_remove_truth, "truth"),
    "no result": (lambda made: (made.result / "result.json").unlink(), "result.json"),
    "damaged result": (_damage("result.json"), "result.json"),
    "other version": (lambda made: made.edit_summary(schema_version=99), "99"),
    "other scene": (lambda made: made.edit_summary(scene="radish", dataset_sha256="0" * 64), "radish"),
    "other frames": (_other_frame, "elsewhere.png"),
    "no leaves": (lambda made: (made.result / "shape.npz").unlink(), "shape.npz"),
    "damaged leaves": (_damage("shape.npz"), "shape.npz"),
    "empty shape": (_empty, "shape.npz"),
    "no mesh": (lambda made: (made.result / "shape.ply").unlink(), "shape.ply"),
    "damaged mesh": (_damage("shape.ply"), "shape.ply"),
    "no true mesh": (lambda made: (made.dataset / "truth" / "specimen.ply").unlink(), "specimen.ply"),
    "open true mesh": (_open_truth, "specimen.ply"),
    "no mask": (lambda made: (made.dataset / "truth" / "masks" / "view_002.png").unlink(), "view_002.png"),
    "damaged mask": (_damage("truth/masks/view_001.png"), "view_001.png"),
    "damaged silhouette": (_damage("silhouettes/view_004.png"), "view_004.png"),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_what_cannot_be_scored_is_named(scan, name):
    change, named = MISTAKES[name]
    made = scan(voxel_mm=1.0)
    change(made)
    with pytest.raises(UserError, match=named) as caught:
        score(made.result, made.dataset)
    assert "\n" not in str(caught.value)
