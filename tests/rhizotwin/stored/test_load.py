"""A result read back is the value that was saved, and scores the same."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rhizotwin.recon.results.parts import Leaves, shape_npz
from rhizotwin.scenes.errors import UserError
from rhizotwin.stored.load import load_result
from rhizotwin.stored.result_files import read_leaves


def test_a_result_saved_again_is_the_same(scan, tmp_path: Path) -> None:
    made = scan(lost=(2,))
    first = load_result(made.result)
    first.save(tmp_path / "again")
    second = load_result(tmp_path / "again")
    for name in ("volume_mm3", "interval_mm3", "trusted", "verdict"):
        assert getattr(second, name) == getattr(first, name)
    assert second.solid.volume == first.solid.volume
    np.testing.assert_array_equal(second.solid.voxels.low, first.solid.voxels.low)
    np.testing.assert_array_equal(second.solid.hull.occupancy, first.solid.hull.occupancy)
    np.testing.assert_allclose(second.solid.mesh.vertices, first.solid.mesh.vertices, atol=1e-5)
    assert list(second.silhouettes) == list(first.silhouettes)
    for file, silhouette in first.silhouettes.items():
        np.testing.assert_array_equal(second.silhouettes[file].coverage, silhouette.coverage)
        np.testing.assert_array_equal(second.silhouettes[file].usable, silhouette.usable)
    for a, b in zip(first.cameras, second.cameras, strict=True):
        assert (a.file, a.used, a.reason, a.markers) == (b.file, b.used, b.reason, b.markers)
        np.testing.assert_array_equal(a.cam_from_canister, b.cam_from_canister)


OTHER_KINDS = [
    ("rig", {"focal_scale": None}),
    ("rig", {"canister_edges": {"before_mm": None, "after_mm": 0.1}}),
    ("rig", {"n_water_found": 1.33}),
    ("rig", {"sway_mm": "<b>"}),
    ("warnings", [5]),
    ("plants", 2),
    ("settings", {"finest_mm": "fine"}),
    ("estimates", [{"name": "tips", "value": 1.0, "interval": [1.0]}]),
    ("volume_interval_mm3", [1.0]),
]


def test_a_value_of_another_kind_is_named(scan) -> None:
    made = scan(voxel_mm=1.0)
    good, said = load_result(made.result).summary(), []
    for key, value in OTHER_KINDS:
        made.edit_summary(**(good | {key: value}))
        with pytest.raises(UserError) as caught:
            load_result(made.result)
        said.append(str(caught.value))
    assert [
        one for one, (key, _) in zip(said, OTHER_KINDS, strict=True) if f"result.json contains an invalid value of '{key}'" not in one
    ] == []


LEAVES = Leaves(
    low=np.zeros((2, 3), np.int32),
    size=np.array([1, 4], np.int32),
    occupancy=np.array([0.0, 1.0], np.float32),
    origin_mm=np.array([-80.0, -80.0, -160.0]),
    voxel_mm=0.27,
)
FAULTS: dict[str, tuple[dict[str, Any], str]] = {
    "leaves between voxels": ({"low": LEAVES.low + 0.5}, "integers"),
    "size of a fraction": ({"size": LEAVES.size / 1.0}, "integers"),
    "size of letters": ({"size": np.array(["a", "b"])}, "integers"),
    "size 0": ({"size": LEAVES.size * 0}, "size of every leaf must be at least 1"),
    "negative size": ({"size": -LEAVES.size}, "size of every leaf must be at least 1"),
    "origin in the plane": ({"origin_mm": LEAVES.origin_mm[:2]}, "origin_mm must be three finite numbers"),
    "unknown origin": ({"origin_mm": LEAVES.origin_mm * np.nan}, "origin_mm must be three finite numbers"),
    "voxel of size 0": ({"voxel_mm": 0.0}, "voxel_mm must be a finite number above 0"),
    "voxel of unknown size": ({"voxel_mm": np.nan}, "voxel_mm must be a finite number above 0"),
    "infinite voxel": ({"voxel_mm": np.inf}, "voxel_mm must be a finite number above 0"),
    "unknown occupancy": ({"occupancy": LEAVES.occupancy * np.nan}, "occupancies must be 0 to 1"),
    "occupancy above 1": ({"occupancy": LEAVES.occupancy * 1e9}, "occupancies must be 0 to 1"),
    "occupancy below 0": ({"occupancy": -LEAVES.occupancy}, "occupancies must be 0 to 1"),
}


@pytest.mark.parametrize("hull", [False, True])
@pytest.mark.parametrize(("changes", "named"), FAULTS.values(), ids=FAULTS)
def test_leaves_that_cannot_be_are_refused(changes: dict[str, Any], named: str, hull: bool, tmp_path: Path) -> None:
    (tmp_path / "shape.npz").write_bytes(shape_npz(LEAVES, LEAVES))
    assert read_leaves(tmp_path, hull=hull).voxel_mm == LEAVES.voxel_mm
    wrong = replace(LEAVES, **changes)
    (tmp_path / "shape.npz").write_bytes(shape_npz(wrong, wrong))
    with pytest.raises(UserError, match=f"shape.npz is damaged: .*{named}; repeat the reconstruction") as caught:
        read_leaves(tmp_path, hull=hull)
    assert "\n" not in str(caught.value)
