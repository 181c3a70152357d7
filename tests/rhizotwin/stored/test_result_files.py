"""Files of results: plain triangles, plants that share a canister, and names of results."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh

from rhizotwin.scenes import rsml
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.rsml import Root
from rhizotwin.stored import plain_ply, result_files, result_names

BALL = trimesh.creation.icosphere(subdivisions=2, radius=7.0)
PLAIN = bytes(trimesh.exchange.ply.export_ply(BALL))
OTHERS = {"normals": trimesh.exchange.ply.export_ply(BALL, vertex_normal=True), "cut short": PLAIN[:-5], "no ply": b"solid\n"}


def read(folder: Path, content: bytes):
    path = folder / "shape.ply"
    path.write_bytes(content)
    return plain_ply.read(path)


def test_triangles_are_what_another_reader_finds(tmp_path: Path) -> None:
    vertices, faces = read(tmp_path, PLAIN)
    other = trimesh.load(tmp_path / "shape.ply", process=False, force="mesh")
    np.testing.assert_array_equal(vertices, other.vertices)
    np.testing.assert_array_equal(faces, other.faces)


def test_other_files_are_left_to_another_reader_or_said(tmp_path: Path) -> None:
    assert {name: read(tmp_path, content) for name, content in OTHERS.items()} == dict.fromkeys(OTHERS)
    read(tmp_path, PLAIN[:-4] + (10**6).to_bytes(4, "little"))
    with pytest.raises(UserError, match="refer to vertices 0 to 1000000, but"):
        result_files.read_mesh(tmp_path / "shape.ply")


def test_a_results_plants_are_compared(ball_result: Callable[..., Path]) -> None:
    folder = ball_result("together")
    assert result_files.read_neighbours(folder) == ()  # no roots were found
    lines = {"A": np.linspace((0.0, 0.0, 0.0), (0.0, 0.0, -30.0), 11), "B": np.linspace((5.0, 0.0, 0.0), (5.0, 0.0, -30.0), 11)}
    roots = [Root(points_mm=line, diameters_mm=np.full(11, 1.0), order=0, parent=-1, plant=plant) for plant, line in lines.items()]
    rsml.write_rsml(folder / "roots.rsml", roots)
    (pair,) = result_files.read_neighbours(folder)
    assert pair.plants == ("A", "B")
    assert pair.nearest_mm == pytest.approx(4.0, abs=0.01)
    rsml.write_rsml(folder / "roots.rsml", roots[:1])
    assert result_files.read_neighbours(folder) == ()


def test_results_of_one_name_are_told_apart_by_the_folders_above(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    given = [Path(one) for one in ("day_1/result", "x/day_2/result", "y/day_2/result", "other", ".")]
    assert result_names.names_of(given) == ["day_1/result", "x/day_2/result", "y/day_2/result", "other", tmp_path.name]
    assert result_names.names_of([Path("a/result"), Path("a/result")]) == ["result", "result"]
    (tmp_path / "day_3").symlink_to(tmp_path)
    assert result_names.names_of([Path("day_3")]) == ["day_3"]
