"""Triangles read from PLY files of results."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from rhizotwin.scenes.errors import UserError
from rhizotwin.stored import plain_ply
from rhizotwin.stored.result_files import read_mesh

BALL = trimesh.creation.icosphere(subdivisions=2, radius=7.0)
PLAIN = bytes(trimesh.exchange.ply.export_ply(BALL))


def read(folder: Path, content: bytes):
    path = folder / "shape.ply"
    path.write_bytes(content)
    return plain_ply.read(path)


def test_it_is_what_another_reader_finds(tmp_path: Path) -> None:
    vertices, faces = read(tmp_path, PLAIN)
    other = trimesh.load(tmp_path / "shape.ply", process=False, force="mesh")
    np.testing.assert_array_equal(vertices, other.vertices)
    np.testing.assert_array_equal(faces, other.faces)


OTHERS = {"normals": trimesh.exchange.ply.export_ply(BALL, vertex_normal=True), "cut short": PLAIN[:-5], "no ply": b"solid\n"}


@pytest.mark.parametrize("content", OTHERS.values(), ids=OTHERS.keys())
def test_other_files_are_left_to_another_reader(tmp_path: Path, content: bytes) -> None:
    assert read(tmp_path, content) is None


def test_what_is_wrong_in_one_is_still_said(tmp_path: Path) -> None:
    read(tmp_path, PLAIN[:-4] + (10**6).to_bytes(4, "little"))
    with pytest.raises(UserError, match="refer to vertices 0 to 1000000, but"):
        read_mesh(tmp_path / "shape.ply")
