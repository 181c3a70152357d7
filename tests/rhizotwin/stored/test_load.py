"""A result read back is the value that was saved, and scores the same."""

from pathlib import Path

import numpy as np
import pytest

from rhizotwin.scenes.errors import UserError
from rhizotwin.stored.load import load_result


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


def test_a_value_of_another_kind_is_named(scan) -> None:
    made = scan(voxel_mm=1.0)
    good = load_result(made.result).summary()
    for key, value in (
        ("rig", {"focal_scale": None}),
        ("plants", 2),
        ("settings", {"finest_mm": "fine"}),
        ("estimates", [{"name": "tips", "value": 1.0, "interval": [1.0]}]),
        ("volume_interval_mm3", [1.0]),
    ):
        made.edit_summary(**(good | {key: value}))
        with pytest.raises(UserError, match=f"result.json contains an invalid value of '{key}'"):
            load_result(made.result)
