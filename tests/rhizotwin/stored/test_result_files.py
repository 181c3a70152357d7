"""Files of results: saved and read back, damaged values, plain triangles, plants that share a canister, and names of results."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from rhizotwin.recon.results.parts import Leaves, shape_npz
from rhizotwin.scenes import atomic, rsml
from rhizotwin.scenes.errors import UserError
from rhizotwin.stored import plain_ply, result_files, result_names
from rhizotwin.stored.load import load_result
from rhizotwin.stored.result_files import read_leaves
from rhizotwin.stored.save import Result
from tests.roots import straight

BALL = trimesh.creation.icosphere(subdivisions=2, radius=7.0)
PLAIN = bytes(trimesh.exchange.ply.export_ply(BALL))
OTHERS = {"normals": trimesh.exchange.ply.export_ply(BALL, vertex_normal=True), "cut short": PLAIN[:-5], "no ply": b"solid\n"}


def read(folder: Path, content: bytes):
    path = folder / "shape.ply"
    path.write_bytes(content)
    return plain_ply.read(path)


def test_plain_triangles_are_read_and_other_files_left(tmp_path: Path) -> None:
    vertices, faces = read(tmp_path, PLAIN)
    other = trimesh.load(tmp_path / "shape.ply", process=False, force="mesh")
    np.testing.assert_array_equal(vertices, other.vertices)
    np.testing.assert_array_equal(faces, other.faces)
    assert {name: read(tmp_path, content) for name, content in OTHERS.items()} == dict.fromkeys(OTHERS)
    read(tmp_path, PLAIN[:-4] + (10**6).to_bytes(4, "little"))
    with pytest.raises(UserError, match="refer to vertices 0 to 1000000, but"):
        result_files.read_mesh(tmp_path / "shape.ply")


def test_a_results_plants_are_compared(ball_result: Callable[..., Path]) -> None:
    folder = ball_result("together")
    roots = [straight((x, 0.0, 0.0), (x, 0.0, -30.0), 1.0, plant=plant) for plant, x in (("A", 0.0), ("B", 5.0))]
    rsml.write_rsml(folder / "roots.rsml", roots)
    (pair,) = result_files.read_neighbours(folder)
    assert pair.plants == ("A", "B")
    assert pair.nearest_mm == pytest.approx(4.0, abs=0.01)


def test_results_of_one_name_are_told_apart_by_the_folders_above(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    given = [Path(one) for one in ("day_1/result", "x/day_2/result", "y/day_2/result", "other", ".")]
    assert result_names.names_of(given) == ["day_1/result", "x/day_2/result", "y/day_2/result", "other", tmp_path.name]
    assert result_names.names_of([Path("a/result"), Path("a/result")]) == ["result", "result"]


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


def files_of(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize(
    ("there", "says"),
    [
        ({"dataset.json": b"{}", "images/a.png": b""}, "is not empty and is not a result"),
        ({"result.json": b"{}", "edits.json": b"{}"}, "contains edits.json, which would be deleted"),
        ({"result.json": b"{}", "stages/hull.json": b"", "my notes.txt": b"!"}, "contains my notes.txt"),
        ({"set/dataset.json": b"{}"}, "is not empty"),
    ],
)
def test_a_result_overwrites_nothing_else(scan, tmp_path: Path, there: dict[str, bytes], says: str) -> None:
    result = Result.of(load_result(scan(voxel_mm=1.0).result))
    for name, content in there.items():
        atomic.write_bytes(tmp_path / "there" / name, content)
    with pytest.raises(UserError, match=says):
        result.save(tmp_path / "there")
    assert files_of(tmp_path / "there") == there


def test_a_saved_result_leaves_nothing_of_an_earlier_one(scan, tmp_path: Path) -> None:
    result, goal = Result.of(load_result(scan(voxel_mm=1.0).result)), tmp_path / "mine"
    atomic.write_bytes(goal / "stages" / "hull.json", b"new")
    result.save(goal)
    first = set(files_of(goal))
    atomic.write_bytes(goal / "report.html", b"of an earlier result")
    result.save(goal)
    assert set(files_of(goal)) == first > {"result.json", "stages/hull.json"}
    with pytest.raises(UserError, match="would overwrite its input"):
        replace(result, dataset=str(goal)).save(goal)


OTHER_KINDS = [
    ("rig", {"canister_edges": {"before_mm": None, "after_mm": 0.1}}),
    ("plants", 2),
    ("settings", {"finest_mm": "fine"}),
    ("estimates", [{"name": "tips", "value": 1.0, "interval": [1.0]}]),
    ("hidden_height_mm", -1.0),
    ("shoot", {"hull_mm3": 9.0, "pot_top_mm": 8.0, "hidden_share": 0.0, "blades_mm2": [2.0, 1.0], "leaf_colours": [{"ndvi": 0.8}]}),
    ("traits", {"total_length_mm": -5.0}),
    ("traits", {"length_by_depth_mm": [1.0, "none"]}),
]


def test_a_value_of_another_kind_is_named(scan) -> None:
    made = scan(voxel_mm=1.0)
    good, said = load_result(made.result).summary(), []
    for key, value in OTHER_KINDS:
        made.edit_summary(**(good | {key: value}))
        with pytest.raises(UserError) as caught:
            load_result(made.result)
        said.append(str(caught.value))
    assert [key for (key, _), one in zip(OTHER_KINDS, said, strict=True) if f"invalid value of '{key}'" not in one] == []
    made.edit_summary(**(good | {"traits": {"volume_mm3": 1.5 * good["volume_mm3"]}}))
    with pytest.raises(UserError, match=r"'traits\.volume_mm3' that is not the one of 'volume_mm3'"):
        load_result(made.result)


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
    "size 0": ({"size": LEAVES.size * 0}, "size of every leaf must be at least 1"),
    "unknown origin": ({"origin_mm": LEAVES.origin_mm * np.nan}, "origin_mm must be three finite numbers"),
    "voxel of unknown size": ({"voxel_mm": np.nan}, "voxel_mm must be a finite number above 0"),
    "occupancy above 1": ({"occupancy": LEAVES.occupancy * 1e9}, "occupancies must be 0 to 1"),
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
