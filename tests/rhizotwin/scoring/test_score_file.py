"""Files of other methods against a truth: what equals it scores as such, and known errors come out as they are."""

import gzip
import io
import json
import shutil
import struct
from dataclasses import replace
from pathlib import Path

import nrrd
import numpy as np
import pytest
import trimesh

from rhizotwin.recon.results.parts import Mesh
from rhizotwin.scenes import rsml
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.rsml import Root
from rhizotwin.scoring import mesh_solid, score_file, score_topology
from rhizotwin.scoring.foreign_files import read_voxels
from rhizotwin.sim import solids
from tests.command import Command
from tests.roots import straight

RADIUS_MM, CENTRE_MM = 8.0, np.array([18.0, 0.0, -60.0])


def truth_of(made: Path) -> trimesh.Trimesh:
    return trimesh.load(made / "truth" / "specimen.ply")


def small_system() -> tuple[Root, ...]:
    """Return a taproot with two laterals, one of which has a lateral of its own."""
    return (
        straight((0.0, 0.0, -20.0), (0.0, 0.0, -60.0), 0.8),
        straight((0.0, 0.0, -30.0), (20.0, 0.0, -35.0), 0.6, order=1, parent=0),
        straight((0.0, 0.0, -40.0), (-20.0, 0.0, -45.0), 0.6, order=1, parent=0),
        straight((10.0, 0.0, -32.5), (10.0, 15.0, -40.0), 0.4, order=2, parent=1),
    )


@pytest.fixture
def planted(made: Path, tmp_path: Path) -> Path:
    """Return the dataset with true centre lines beside its solid."""
    shutil.copytree(made, tmp_path / "planted")
    rsml.write_rsml(tmp_path / "planted" / "truth" / "skeleton.rsml", small_system())
    return tmp_path / "planted"


@pytest.mark.parametrize(("suffix", "unit"), [("stl", 1.0), ("obj", 1.0), ("glb", 1000.0)])
def test_a_mesh_that_equals_the_truth(made: Path, tmp_path: Path, suffix: str, unit: float) -> None:
    mesh = truth_of(made)
    if suffix != "stl":
        x, y, z = mesh.vertices.T
        mesh = trimesh.Trimesh(np.stack([x, z, -y], axis=1) / unit, mesh.faces, process=False)
    mesh.export(tmp_path / f"shape.{suffix}")
    found = score_file.score_mesh(tmp_path / f"shape.{suffix}", made)
    assert abs(found.volume_error) < 1e-4
    assert found.iou > 0.999
    assert found.surface.p95_mm < 1e-3
    assert np.abs(found.extents_error).max() < 1e-4
    assert ("y is up" in "".join(found.notes)) == (suffix == "obj")


@pytest.mark.parametrize(
    ("name", "scale", "unit", "registered"),
    [("a.stl", 0.1, "cm", False), ("a.stl", 1 / 25.4, "inch", True), ("a.obj", 0.001, "m", False), ("a.glb", 1.0, "mm instead of m", True)],
)
def test_meshes_in_other_units_are_named(made: Path, tmp_path: Path, *, name: str, scale: float, unit: str, registered: bool) -> None:
    truth_of(made).apply_scale(scale).export(tmp_path / name)
    with pytest.raises(UserError, match=f"{name}: the coordinates are probably in {unit}"):
        score_file.score_mesh(tmp_path / name, made, registered=registered)


def test_a_mesh_elsewhere_is_laid_onto_the_truth_if_asked(made: Path, tmp_path: Path) -> None:
    mesh = truth_of(made)
    mesh.apply_scale(1.05)
    mesh.apply_translation((40.0, -10.0, 3.0))
    mesh.export(tmp_path / "away.ply")
    there = score_file.score_mesh(tmp_path / "away.ply", made)
    laid = score_file.score_mesh(tmp_path / "away.ply", made, registered=True)
    assert there.volume_error == pytest.approx(1.05**3 - 1.0, rel=1e-3)
    assert laid.volume_error == pytest.approx(there.volume_error)
    assert there.iou == 0.0
    assert laid.iou == pytest.approx(1.05**-3, abs=1e-3)  # the smaller ball lies in the larger one


def ball(radius_mm: float, *, shift_mm: float = 0.0) -> trimesh.Trimesh:
    made = trimesh.creation.icosphere(subdivisions=3, radius=radius_mm)
    made.apply_translation(CENTRE_MM + np.array([shift_mm, 0.0, 0.0]))
    return made


def inverted(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    return trimesh.Trimesh(mesh.vertices, mesh.faces[:, ::-1], process=False)


@pytest.mark.parametrize(
    ("shells", "volume", "iou"),
    [
        ([ball(8.0), ball(8.0, shift_mm=8.0)], 27.0 / 16.0, 16.0 / 27.0),  # less the lens that both balls contain
        ([ball(8.0), ball(8.0, shift_mm=12.0), inverted(ball(3.0))], 953.0 / 512.0, 485.0 / 980.0),
        ([inverted(ball(8.0))], 1.0, 1.0),
    ],
    ids=["overlapping", "with_a_cavity", "inside_out"],
)
def test_overlapping_shells_count_once(
    made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, shells: list[trimesh.Trimesh], volume: float, iou: float
) -> None:
    monkeypatch.setattr(mesh_solid, "_MOST_SIDE", 60)  # voxels of the mesh that is inside out
    trimesh.util.concatenate(shells).export(tmp_path / "shells.ply")
    found = score_file.score_mesh(tmp_path / "shells.ply", made)
    assert (found.volume_error + 1.0, found.iou) == (pytest.approx(volume, abs=0.01), pytest.approx(iou, abs=0.01))
    assert found.iou <= 1.0
    assert found.notes


def test_a_shell_that_intersects_itself_counts_once() -> None:
    turn_rad = np.linspace(0.0, 2.25 * np.pi, 91)  # the last eighth of a turn lies in the first
    ring = 10.0 * np.stack([np.cos(turn_rad), np.sin(turn_rad), np.zeros(91)], axis=1)
    vertices, faces = solids.tube(ring, np.full(91, 3.0), sides=32)
    found = mesh_solid.to_solid(Mesh(vertices_mm=vertices, faces=faces.astype(np.int64)))
    assert found.was_united
    assert found.solid.volume() == pytest.approx(2.0 * np.pi**2 * 10.0 * 3.0**2, rel=2e-3)


def test_an_open_mesh_has_distances_and_no_volume(made: Path, tmp_path: Path) -> None:
    mesh = truth_of(made)
    trimesh.Trimesh(mesh.vertices, mesh.faces[: len(mesh.faces) // 2], process=False).export(tmp_path / "open.ply")
    found = score_file.score_mesh(tmp_path / "open.ply", made)
    assert (found.volume_mm3, found.iou) == (None, None)
    assert found.surface.result_to_truth_p95_mm < 1e-3
    assert "not closed" in found.notes[0]


def test_voxels_of_a_ball(made: Path, tmp_path: Path) -> None:
    voxel_mm, low = 0.25, CENTRE_MM - 10.0
    centres = low + voxel_mm * (np.stack(np.meshgrid(*[np.arange(80)] * 3, indexing="ij"), axis=-1) + 0.5)
    inside = np.linalg.norm(centres - CENTRE_MM, axis=-1) < RADIUS_MM
    np.savez(tmp_path / "voxels.npz", occupancy=inside, origin_mm=low, voxel_mm=voxel_mm)
    first = low + 0.5 * voxel_mm
    header = {"space dimension": 3, "space directions": -voxel_mm * np.eye(3)[[2, 0, 1]], "space origin": first + 19.75}
    nrrd.write(str(tmp_path / "voxels.nrrd"), 255 * inside[::-1, ::-1, ::-1].transpose(2, 0, 1).astype(np.int16), header, index_order="F")
    spaced = {"spacings": [voxel_mm] * 3, "axis mins": list(first)}
    nrrd.write(str(tmp_path / "spaced.nrrd"), inside.astype(np.uint8), spaced, index_order="F")
    np.testing.assert_allclose(read_voxels(tmp_path / "spaced.nrrd")[0].origin_mm, low)
    for block in (inside, inside.astype(np.uint8), 255 * inside.astype(np.int16), inside.astype(np.int64), inside.astype(np.float32)):
        np.savez(tmp_path / "kind.npz", occupancy=block, origin_mm=low, voxel_mm=voxel_mm)
        assert (read_voxels(tmp_path / "kind.npz")[0].occupancy == 1.0).all(), block.dtype
    for wrong_mm in (1e9, 0.001):
        np.savez(tmp_path / "wrong.npz", occupancy=inside, origin_mm=low, voxel_mm=wrong_mm)
        with pytest.raises(UserError, match="check the voxel size and its unit"):
            score_file.score_voxels(tmp_path / "wrong.npz", made)
    of_npz, of_nrrd = (score_file.score_voxels(tmp_path / f"voxels.{suffix}", made) for suffix in ("npz", "nrrd"))
    assert of_npz.volume_error == pytest.approx(inside.sum() * voxel_mm**3 / (4.0 / 3.0 * np.pi * RADIUS_MM**3) - 1.0, abs=0.01)
    assert of_npz.iou > 0.95
    assert of_npz.surface.median_mm < voxel_mm / 2.0
    assert (of_nrrd.volume_error, of_nrrd.iou) == (of_npz.volume_error, of_npz.iou)


def test_points_are_scored_by_their_distances(made: Path, tmp_path: Path) -> None:
    directions = np.random.default_rng(0).normal(size=(4000, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    np.savetxt(tmp_path / "points.xyz", CENTRE_MM + (RADIUS_MM + 0.3) * directions)
    found = score_file.score_points(tmp_path / "points.xyz", made)
    assert found.surface.result_to_truth_median_mm == pytest.approx(0.3, abs=0.03)  # the true ball has facets
    assert found.volume_mm3 is None


def test_centre_lines_that_equal_the_truth(planted: Path) -> None:
    found = score_file.score_rsml(planted / "truth" / "skeleton.rsml", planted)
    assert abs(found.roots.length_error) < 1e-4
    assert (found.roots.tip_recall, found.roots.tip_precision) == (1.0, 1.0)
    assert (found.topology.matched, found.topology.parents, found.topology.orders) == (1.0, 1.0, 1.0)
    assert all(abs(one.error) < 1e-9 for one in found.traits.values())
    # CPlantBox omits the first points of laterals
    tap, *laterals = small_system()
    shorter = [replace(root, points_mm=root.points_mm[1:], diameters_mm=root.diameters_mm[1:]) for root in laterals]
    rsml.write_rsml(planted / "omitted.rsml", [tap, *shorter])
    found = score_file.score_rsml(planted / "omitted.rsml", planted)
    assert abs(found.roots.length_error) < 1e-4
    assert "3 roots that begin at a distance" in found.notes[0]


def test_a_wrong_parent_and_a_missing_root_are_seen() -> None:
    true = small_system()
    wrong = (*true[:3], replace(true[3], parent=0, order=1))
    found = score_topology.compare_topology(wrong, true)
    assert (found.matched, found.parents, found.orders) == (1.0, 0.75, 0.75)
    fewer = score_topology.compare_topology(true[:2], true)
    assert (fewer.roots, fewer.matched, fewer.parents) == (2, 0.5, 1.0)


def test_stated_intervals_are_judged(planted: Path, tmp_path: Path) -> None:
    true_mm = rsml.length_mm(small_system())
    table = f"trait,value,low,high\ntotal_length,{0.9 * true_mm},{0.8 * true_mm},{0.95 * true_mm}\nroots,4,,\nmine,3,,\n"
    (tmp_path / "traits.csv").write_text(table)
    found = score_file.score_traits(tmp_path / "traits.csv", planted).traits
    assert set(found) == {"total_length", "roots"}
    assert found["total_length"].error == pytest.approx(-0.1)
    assert found["total_length"].holds is False
    assert found["total_length"].interval_score == pytest.approx(0.15 + 20.0 * 0.05)  # width, and 2 / 0.1 times the miss
    assert (found["roots"].error, found["roots"].holds) == (0.0, None)
    assert score_file.interval_score((0.9, 1.2), 1.0) == pytest.approx(0.3)


@pytest.mark.parametrize(
    ("option", "name", "content", "word"),
    [
        ("mesh", "a.ply", b"rubbish", "mesh"),
        ("voxels", "a.npz", b"rubbish", "voxels"),
        ("points", "a.xyz", b"a b c\n", "points"),
        ("rsml", "a.rsml", b"<", "rsml"),
        ("traits", "a.csv", b"trait,value\nvolume,much\n", "not a number"),
    ],
)
def test_what_cannot_be_scored_is_one_sentence(
    command: Command, made: Path, tmp_path: Path, option: str, name: str, content: bytes, word: str
) -> None:
    (tmp_path / name).write_bytes(content)
    command.fails("score", f"--{option}", tmp_path / name, made, named=[word, name])


def nrrd_of(header: str, data: bytes = b"") -> bytes:
    fields = f"NRRD0004\ntype: uchar\ndimension: 3\nspace dimension: 3\nspace directions: (1,0,0) (0,1,0) (0,0,1)\n{header}\n\n"
    return fields.encode() + data


def npz_of(**arrays: np.ndarray) -> bytes:
    packed = io.BytesIO()
    np.savez_compressed(packed, **arrays)
    return packed.getvalue()


HOSTILE = {
    "other_file.nrrd": nrrd_of("space origin: (0,0,0)\nsizes: 2 2 2\nencoding: raw\ndata file: /etc/passwd"),
    "larger_than_it_says.nrrd": nrrd_of("space origin: (0,0,0)\nsizes: 2 2 2\nencoding: gzip", gzip.compress(bytes(3 * 2**20))),
    "empty.nrrd": b"",
    "no_position.nrrd": b"NRRD0004\ntype: uchar\ndimension: 3\nsizes: 1 1 1\nspacings: 1 1 1\nencoding: raw\n\n1",
    "labels.npz": npz_of(occupancy=np.arange(8).reshape(2, 2, 2), origin_mm=np.zeros(3), voxel_mm=np.array(1.0)),
    "too_large.nrrd": nrrd_of("space origin: (0,0,0)\nsizes: 99999 99999 99999\nencoding: raw"),
    "truncated.nrrd": nrrd_of("space origin: (0,0,0)\nsizes: 2 2 2\nencoding: raw", b"1"),
    "bomb.npz": npz_of(occupancy=np.zeros((128, 128, 128), np.uint8), origin_mm=np.zeros(3), voxel_mm=np.array(1.0)),
}


@pytest.mark.parametrize("name", sorted(HOSTILE))
def test_hostile_voxels_are_one_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    monkeypatch.setattr("rhizotwin.stored.result_files.MOST_SHAPE_MIB", 1)
    (tmp_path / name).write_bytes(HOSTILE[name])
    with pytest.raises(UserError, match=name):
        read_voxels(tmp_path / name)


@pytest.mark.parametrize("name", ["KHR_draco_mesh_compression", "EXT_meshopt_compression", "ACME_other"])
def test_extensions_of_gltf_are_named(command: Command, made: Path, tmp_path: Path, name: str) -> None:
    text = json.dumps({"asset": {"version": "2.0"}, "extensionsRequired": [name]}).encode()
    (tmp_path / "a.glb").write_bytes(struct.pack("<4sIII4s", b"glTF", 2, 20 + len(text), len(text), b"JSON") + text)
    command.fails("score", "--mesh", tmp_path / "a.glb", made, named=[name, "export it without compression"])


def test_the_command_line_scores_a_file(command: Command, made: Path) -> None:
    file = made / "truth" / "specimen.ply"
    assert "IoU" in command.works("score", "--mesh", file, made).out
    assert json.loads(command.works("score", "--mesh", file, made, "--json").out)["iou"] > 0.999
    command.fails("score", "--mesh", file, "--rsml", file, made, named=["one file"])
    command.fails("score", "--rsml", file, made, "--registered", named=["--registered"])
