"""Triangles read from PLY files of results."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from rhizotwin.recon.results import plain_ply
from rhizotwin.recon.results.result_files import read_mesh
from rhizotwin.scenes.errors import UserError


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "shape.ply"
    path.write_bytes(bytes(trimesh.exchange.ply.export_ply(trimesh.creation.icosphere(subdivisions=3, radius=7.0))))
    return path


def test_it_is_what_another_reader_finds(file: Path) -> None:
    found = plain_ply.read(file)
    assert found is not None
    other = trimesh.load(file, process=False, force="mesh")
    np.testing.assert_array_equal(found[0], other.vertices)
    np.testing.assert_array_equal(found[1], other.faces)


OTHERS = {
    "ascii": lambda mesh: trimesh.exchange.ply.export_ply(mesh, encoding="ascii"),
    "normals": lambda mesh: trimesh.exchange.ply.export_ply(mesh, vertex_normal=True),
    "cut short": lambda mesh: trimesh.exchange.ply.export_ply(mesh)[:-5],
    "longer": lambda mesh: trimesh.exchange.ply.export_ply(mesh) + b"\0",
    "no ply": lambda _: b"solid\n",
}


@pytest.mark.parametrize("made", OTHERS.values(), ids=OTHERS.keys())
def test_other_files_are_left_to_another_reader(tmp_path: Path, made) -> None:
    path = tmp_path / "other.ply"
    made_of = made(trimesh.creation.icosphere(subdivisions=1))
    path.write_bytes(made_of if isinstance(made_of, bytes) else made_of.encode())
    assert plain_ply.read(path) is None


def test_what_is_wrong_in_one_is_still_said(file: Path) -> None:
    whole = bytearray(file.read_bytes())
    whole[-4:] = (10**6).to_bytes(4, "little")
    file.write_bytes(whole)
    with pytest.raises(UserError, match="names vertex 1000000"):
        read_mesh(file)
