"""What every command says to input that cannot be used: one sentence that names it, an exit code, nothing left behind."""

import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import trimesh

from rhizotwin.recon.hull import carve
from rhizotwin.scenes.atomic import write_image

FAST = ("--device", "cpu", "--voxel-mm", "2")


def nothing_left(folder: Path, *known: str) -> None:
    """Check that a folder holds these names and nothing else, and no temporary file anywhere."""
    assert sorted(path.name for path in folder.iterdir()) == sorted(known)
    assert not [path for path in folder.rglob("*") if path.name.endswith(".tmp")]


def picture(dataset: Path, k: int) -> Path:
    return dataset / "images" / f"view_{k:03d}.png"


def read(path: Path) -> np.ndarray:
    return np.asarray(cv2.imread(str(path), cv2.IMREAD_UNCHANGED))


def crop(path: Path) -> None:
    write_image(path, np.ascontiguousarray(read(path)[:-2, :-4]))


def cut(path: Path, keep: float = 0.6) -> None:
    data = path.read_bytes()
    path.write_bytes(data[: int(keep * len(data))])


def replace_text(path: Path, old: str, new: str) -> None:
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new, 1), encoding="utf-8")


@dataclass(frozen=True)
class Spoilt:
    """What is done to a file or folder, and what the sentence must name."""

    name: str
    spoil: Callable[[Path], object]
    named: tuple[str, ...]


PICTURES = [
    Spoilt("missing", lambda path: path.unlink(), ("view_003.png", "missing", "restore it")),
    Spoilt("a folder", lambda path: (path.unlink(), path.mkdir()), ("view_003.png", "cannot be read")),
    Spoilt("empty", lambda path: path.write_bytes(b""), ("view_003.png", "empty (0 bytes)", "copy or take it again")),
    Spoilt("truncated", cut, ("view_003.png", "truncated", "copy or take it again")),
    Spoilt("no picture", lambda path: path.write_text("hello"), ("view_003.png", "is not a picture")),
    Spoilt("another size", crop, ("view_003.png", "316x238", "320x240", "image_wh")),
]


@pytest.mark.parametrize("spoilt", PICTURES, ids=lambda spoilt: spoilt.name)
def test_picture_of_a_dataset(spoilt: Spoilt, dataset: Path, tmp_path: Path, command: Any) -> None:
    spoilt.spoil(picture(dataset, 3))
    command.fails("reconstruct", dataset, "-o", tmp_path / "result", *FAST, named=spoilt.named)
    nothing_left(tmp_path, "dataset")


@pytest.mark.parametrize("spoilt", [one for one in PICTURES if one.name not in ("missing", "a folder")], ids=lambda spoilt: spoilt.name)
@pytest.mark.parametrize("suffix", [".png", ".jpg", ".tiff"])
def test_picture_to_import(spoilt: Spoilt, suffix: str, made: Path, rig: Path, tmp_path: Path, command: Any) -> None:
    pictures = Path(shutil.copytree(made / "images", tmp_path / "pictures"))
    image = (read(picture(made, 3)) >> 8).astype(np.uint8)
    (pictures / "view_003.png").unlink()
    bad = pictures / f"view_003{suffix}"
    write_image(bad, image)
    spoilt.spoil(bad)
    named = [word.replace("view_003.png", bad.name) for word in spoilt.named]
    if spoilt.name == "truncated" and suffix == ".tiff":  # which only a decoder can tell
        named = [bad.name, "the picture is"]
    command.fails("import", pictures, "--scene", rig, "-o", tmp_path / "out", named=named)
    nothing_left(tmp_path, "pictures")


def test_folders_without_pictures(rig: Path, tmp_path: Path, command: Any) -> None:
    command.fails("import", tmp_path / "no", "--scene", rig, "-o", tmp_path / "out", named=[tmp_path / "no", "no folder"])
    (tmp_path / "pictures").mkdir()
    command.fails("import", tmp_path / "pictures", "--scene", rig, "-o", tmp_path / "out", named=["pictures", "holds no picture"])
    nothing_left(tmp_path, "pictures")


def test_cameras_cut_short(made: Path, rig: Path, tmp_path: Path, command: Any) -> None:
    cameras = tmp_path / "transforms.json"
    cameras.write_text('{"fl_x": 1300.0, "frames": [')
    words = ("import", made / "images", "--scene", rig, "--cameras", cameras, "-o", tmp_path / "out")
    command.fails(*words, named=[cameras, "not JSON"])
    nothing_left(tmp_path, "transforms.json")


MANIFESTS = [
    Spoilt(
        "unknown version", lambda path: replace_text(path, '"schema_version": 1', '"schema_version": 99'), ("has version 99", "reads 1")
    ),
    Spoilt("no version", lambda path: replace_text(path, '"schema_version": 1,', ""), ("no schema_version",)),
    Spoilt("cut short", cut, ("damaged", "JSON", "make it again")),
    Spoilt("no object", lambda path: path.write_text("[1, 2]"), ("damaged", "make it again")),
    Spoilt("no text", lambda path: path.write_bytes(b"\xff\x00\xfe"), ("damaged",)),
    Spoilt("missing", lambda path: path.unlink(), ("no dataset", "rhizotwin simulate")),
    Spoilt("unknown key", lambda path: replace_text(path, '"level_mm"', '"levle_mm"'), ("levle_mm", "level_mm")),
    Spoilt("impossible value", lambda path: replace_text(path, '"n_water": 1.333', '"n_water": -1'), ("n_water", "-1")),
    Spoilt("not a number", lambda path: replace_text(path, '"n_water": 1.333', '"n_water": NaN'), ("n_water",)),
    Spoilt(
        "path outside", lambda path: replace_text(path, "images/view_003.png", "../../view_003.png"), ("frames 4", "must be a path inside")
    ),
]


@pytest.mark.parametrize("spoilt", MANIFESTS, ids=lambda spoilt: spoilt.name)
def test_manifest(spoilt: Spoilt, dataset: Path, tmp_path: Path, command: Any) -> None:
    spoilt.spoil(dataset / "dataset.json")
    command.fails("reconstruct", dataset, "-o", tmp_path / "result", *FAST, named=["dataset.json", *spoilt.named])
    nothing_left(tmp_path, "dataset")


def test_folder_that_is_no_dataset(tmp_path: Path, command: Any) -> None:
    (tmp_path / "folder").mkdir()
    (tmp_path / "file").touch()
    for name, named in (("folder", "is no dataset"), ("file", "no such folder"), ("nothing", "no such folder")):
        command.fails(
            "reconstruct", tmp_path / name, "-o", tmp_path / "result", *FAST, named=[tmp_path / name, named, "rhizotwin simulate"]
        )
    nothing_left(tmp_path, "folder", "file")


def without_markers(path: Path, keep_columns: int = 0) -> None:
    """Paint over the strip, but for its left part."""
    pixels = read(path)
    pixels[:72, keep_columns:] = pixels.max()
    write_image(path, pixels)


def test_views_with_few_markers_are_left_out_and_named(dataset: Path, tmp_path: Path, command: Any, change_manifest: Any) -> None:
    without_markers(picture(dataset, 2))
    without_markers(picture(dataset, 5), keep_columns=90)
    change_manifest(dataset, lambda _: None)
    done = command.works("reconstruct", dataset, "-o", tmp_path / "result", *FAST)
    warnings = [line for line in done.out.splitlines() if line.startswith("warning: ") and "left out" in line]
    assert len(warnings) == 2, done.out
    assert "view_002.png is left out: no markers were found" in warnings[0]
    assert "view_005.png is left out: " in warnings[1]
    assert "only 2 markers, at least 4 are needed" in warnings[1]
    assert "8 of 10 views used" in done.out
    nothing_left(tmp_path, "dataset", "result")


def test_too_few_views_left(dataset: Path, tmp_path: Path, command: Any, change_manifest: Any) -> None:
    for k in range(8):
        without_markers(picture(dataset, k))
    change_manifest(dataset, lambda _: None)
    words = ("reconstruct", dataset, "-o", tmp_path / "result", *FAST)
    command.fails(*words, named=[dataset, "only 2 of 10", "at least 3", "view_000.png: no markers were found"])
    for k in (8, 9):
        without_markers(picture(dataset, k))
    command.fails(*words, named=["view_000.png", "no markers were found", "any of the 10 pictures"])
    nothing_left(tmp_path, "dataset")


STRIPS: list[tuple[dict[str, Any], tuple[str, ...]]] = [
    ({"first_id": 100}, ("markers of another strip", "100 to 161")),
    ({"dictionary": "4X4_250"}, ("markers of another strip", "they are of APRILTAG_36h11", "4X4_250")),
    ({"first_id": 13}, ("markers of another strip", "0, 1, 2, 3, 4", "13 to 74")),
    ({"first_id": 5}, ("markers of another strip", "0, 1, 2, 3, 4", "5 to 66")),
    ({"rows": 1}, ("markers of another strip", "0 to 30")),
    ({"columns": 28}, ("scene", "columns")),
]


@pytest.mark.parametrize(("change", "named"), STRIPS, ids=lambda value: str(value) if isinstance(value, dict) else "")
def test_markers_of_another_strip(
    change: dict[str, Any], named: tuple[str, ...], dataset: Path, tmp_path: Path, command: Any, change_manifest: Any
) -> None:
    """Also where a part of the markers has ids that the scene's strip has too: their poses would be wrong."""
    change_manifest(dataset, lambda content: content["scene"]["strip"].update(change))
    command.fails("reconstruct", dataset, "-o", tmp_path / "result", *FAST, named=["images/view_00", *named])
    nothing_left(tmp_path, "dataset")


def test_empty_silhouette(dataset: Path, tmp_path: Path, command: Any, change_manifest: Any) -> None:
    below = np.s_[80:]
    empty = np.stack([read(path) for path in sorted((dataset / "images").iterdir())]).max(axis=0)
    pixels = read(picture(dataset, 4))
    assert (pixels[below] < 0.5 * empty[below]).any()
    pixels[below] = empty[below]
    write_image(picture(dataset, 4), pixels)
    change_manifest(dataset, lambda _: None)
    words = ("reconstruct", dataset, "-o", tmp_path / "result", *FAST)
    command.fails(*words, named=["view_004.png", "empty silhouette (1 of 10", "take it out"])
    nothing_left(tmp_path, "dataset")


def test_pictures_without_backlight(dataset: Path, tmp_path: Path, command: Any, change_manifest: Any) -> None:
    for k in range(10):
        pixels = read(picture(dataset, k))
        pixels[76:] = 0
        write_image(picture(dataset, k), pixels)
    change_manifest(dataset, lambda _: None)
    command.fails("reconstruct", dataset, "-o", tmp_path / "result", *FAST, named=["view_000.png", "nothing of the water", "backlight"])
    nothing_left(tmp_path, "dataset")


def test_empty_masks(rig: Path, tmp_path: Path, command: Any) -> None:
    (tmp_path / "masks").mkdir()
    for k in range(4):
        write_image(tmp_path / "masks" / f"{k}.png", np.zeros((240, 320), np.uint8))
    words = ("import", tmp_path / "masks", "--masks", "--scene", rig, "-o", tmp_path / "out")
    command.fails(*words, named=["--masks", "--cameras"])
    lens = {"fl_x": 520.0, "cx": 160.0, "cy": 120.0, "w": 320, "h": 240}
    pose = np.eye(4) + 400.0 * np.eye(4, k=3)
    (tmp_path / "cameras.json").write_text(
        json.dumps({**lens, "frames": [{"file_path": f"{k}.png", "transform_matrix": pose.tolist()} for k in range(4)]})
    )
    command.fails(*words, "--cameras", tmp_path / "cameras.json", named=["masks", "every silhouette is empty", "white must be root"])
    nothing_left(tmp_path, "masks", "cameras.json")


def ball(radius: float = 8.0, shift: tuple[float, float, float] = (0.0, 0.0, -60.0)) -> trimesh.Trimesh:
    mesh = trimesh.creation.icosphere(subdivisions=2, radius=radius)
    mesh.apply_translation(shift)
    return mesh


def holed(path: Path) -> None:
    mesh = ball()
    mesh.update_faces(np.arange(len(mesh.faces)) > 2)
    mesh.export(path)


RSML = """<rsml><metadata><version>1</version><unit>mm</unit><resolution>1</resolution></metadata><scene><plant><root ID="1"><geometry>
<polyline><point x="0" y="0" z="-20"/><point x="{x}" y="0" z="-60"/></polyline></geometry><functions>
<function name="diameter" domain="polyline"><sample>1</sample><sample>1</sample></function></functions></root></plant></scene></rsml>"""

SPECIMENS = [
    Spoilt("open.stl", holed, ("open.stl", "not closed", "edges are open", "close its holes")),
    Spoilt("wall.ply", lambda path: ball(shift=(70.0, 0.0, -60.0)).export(path), ("wall.ply", "past the inner wall", "move or shrink")),
    Spoilt("floor.obj", lambda path: ball(shift=(0.0, 0.0, -145.0)).export(path), ("floor.obj", "below the floor", "move or shrink")),
    Spoilt("surface.stl", lambda path: ball(shift=(0.0, 0.0, 0.0)).export(path), ("surface.stl", "above the water's surface")),
    Spoilt("metres.stl", lambda path: ball(0.008, (0.0, 0.0, -0.06)).export(path), ("metres.stl", "millimetres", "scale it up")),
    Spoilt("cut.stl", lambda path: (ball().export(path), cut(path)), ("cut.stl", "export")),
    Spoilt("text.ply", lambda path: path.write_text("no mesh"), ("text.ply", "cannot be read")),
    Spoilt("nothing.obj", lambda path: path.write_text(""), ("nothing.obj",)),
    Spoilt("picture.png", lambda path: path.write_bytes(b"\x89PNG"), ("picture.png", "PLY, STL or OBJ")),
    Spoilt("wall.rsml", lambda path: path.write_text(RSML.format(x=90)), ("wall.rsml", "past the inner wall", "move or shrink")),
    Spoilt("cut.rsml", lambda path: (path.write_text(RSML.format(x=5)), cut(path)), ("cut.rsml",)),
    Spoilt("missing.stl", lambda _: None, ("missing.stl", "no such file")),
]


@pytest.mark.parametrize("spoilt", SPECIMENS, ids=lambda spoilt: spoilt.name)
def test_specimen(spoilt: Spoilt, tmp_path: Path, command: Any) -> None:
    path = tmp_path / spoilt.name
    spoilt.spoil(path)
    known = [path.name] if path.exists() else []
    command.fails("simulate", "sphere_20mm", "--specimen", path, "-o", tmp_path / "out", "--device", "cpu", named=spoilt.named)
    nothing_left(tmp_path, *known)


SCENES = [
    Spoilt("unknown key", lambda path: replace_text(path, "level_mm", "levle_mm"), ("line", "levle_mm", "level_mm")),
    Spoilt("impossible", lambda path: replace_text(path, "outer_radius_mm = 76.2", "outer_radius_mm = -1"), ("outer_radius_mm", "-1")),
    Spoilt(
        "sphere outside", lambda path: replace_text(path, "centre_mm = [0.0", "centre_mm = [70.0"), ("centre_mm", "must stay in the water")
    ),
    Spoilt("no TOML", lambda path: path.write_text("[canister"), ("not valid TOML",)),
    Spoilt("missing", lambda path: path.unlink(), ("no such file",)),
]


@pytest.mark.parametrize("spoilt", SCENES, ids=lambda spoilt: spoilt.name)
def test_scene_file(spoilt: Spoilt, tmp_path: Path, command: Any) -> None:
    path = tmp_path / "mine.toml"
    command.works("scenes", "sphere_20mm", "-o", path)
    spoilt.spoil(path)
    known = [path.name] if path.exists() else []
    for words in (("simulate", path), ("import", tmp_path, "--scene", path)):
        command.fails(*words, "-o", tmp_path / "out", named=[path, *spoilt.named])
    nothing_left(tmp_path, *known)


def test_unknown_names_get_a_suggestion(tmp_path: Path, command: Any) -> None:
    command.fails("simulate", "spere_20mm", "-o", tmp_path / "out", named=["spere_20mm", 'did you mean "sphere_20mm"', "rhizotwin scenes"])
    command.fails("simulate", "sphere_20mm", "--profile", "bensh", "-o", tmp_path / "out", named=["bensh", 'did you mean "bench"'])
    nothing_left(tmp_path)


@pytest.mark.parametrize("value", ["0", "nan", "-1", "inf", "1e-9", "0.009", "1e9", "11", "a", ""])
def test_voxel_mm(value: str, dataset: Path, tmp_path: Path, command: Any) -> None:
    words = ("reconstruct", dataset, "-o", tmp_path / "result", f"--voxel-mm={value}")
    command.fails(*words, named=["--voxel-mm", value, "millimetres" if value in ("a", "") else "0.01 to 10 mm"])
    nothing_left(tmp_path, "dataset")


def test_voxels_too_small_for_the_memory(dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: Any) -> None:
    monkeypatch.setattr(carve.os, "sysconf", lambda _: 1000)  # pages of as many bytes
    words = ("reconstruct", dataset, "-o", tmp_path / "result", "--voxel-mm", "0.1", "--device", "cpu")
    command.fails(*words, named=["not enough memory", "--voxel-mm"], code=1)
    nothing_left(tmp_path, "dataset")


def test_result_folder_with_other_content(scan: Path, command: Any) -> None:
    """A result is replaced, but nothing else is ever lost."""
    result = scan / "result"
    (result / "notes.txt").write_text("years of work")
    command.fails("reconstruct", scan / "dataset", "-o", result, *FAST, named=[result, "notes.txt", "choose a new folder"])
    assert (result / "notes.txt").read_text() == "years of work"
    (result / "result.json").unlink()
    command.fails("reconstruct", scan / "dataset", "-o", result, *FAST, named=[result, "no result", "choose a new folder"])
    command.fails("reconstruct", scan / "dataset", "-o", result / "notes.txt", *FAST, named=[result / "notes.txt", "is a file"])
    command.fails("reconstruct", scan / "dataset", "-o", scan / "dataset", *FAST, named=[scan / "dataset", "no result"])
    command.fails("simulate", "sphere_20mm", "-o", result, "--device", "cpu", named=[result, "not empty", "choose a new folder"])
    command.fails("simulate", "sphere_20mm", "-o", result / "notes.txt", "--device", "cpu", named=["notes.txt: is a file"])
    words = ("simulate", "printed_8ml", "-o", scan / "dataset", "--device", "cpu")
    command.fails(*words, named=[scan / "dataset", "made with another", "scene", "choose a new folder"])
    nothing_left(scan, "dataset", "result")
    assert (result / "notes.txt").read_text() == "years of work"


def test_import_into_a_folder_with_other_content(made: Path, rig: Path, tmp_path: Path, command: Any) -> None:
    (tmp_path / "notes.txt").write_text("years of work")
    command.fails("import", made / "images", "--scene", rig, "-o", tmp_path, named=[tmp_path, "not empty", "choose another name"])
    nothing_left(tmp_path, "notes.txt")


SCORED = [
    Spoilt("shape.npz cut", lambda scan: cut(scan / "result/shape.npz"), ("shape.npz", "damaged", "reconstruct again")),
    Spoilt("shape.npz missing", lambda scan: (scan / "result/shape.npz").unlink(), ("shape.npz", "does not exist", "reconstruct again")),
    Spoilt("result.json cut", lambda scan: cut(scan / "result/result.json"), ("result.json", "not readable JSON", "reconstruct again")),
    Spoilt("result.json missing", lambda scan: (scan / "result/result.json").unlink(), ("result.json", "does not exist")),
    Spoilt(
        "result.json of another version",
        lambda scan: replace_text(scan / "result/result.json", '"schema_version": 1', '"schema_version": 7'),
        ("result.json", "schema_version 7", "reads 1"),
    ),
    Spoilt(
        "result.json with a word for a number",
        lambda scan: replace_text(scan / "result/result.json", '"voxel_mm": 2.0', '"voxel_mm": "two"'),
        ("result.json", "voxel_mm", "reconstruct again"),
    ),
    Spoilt("shape.ply cut", lambda scan: cut(scan / "result/shape.ply"), ("shape.ply", "not a readable mesh")),
    Spoilt("silhouette cut", lambda scan: cut(scan / "result/silhouettes/view_003.png"), ("silhouettes", "view_003.png", "truncated")),
    Spoilt("true mask cut", lambda scan: cut(scan / "dataset/truth/masks/view_003.png"), ("masks", "view_003.png", "truncated")),
    Spoilt("truth cut", lambda scan: cut(scan / "dataset/truth/truth.json"), ("truth.json", "damaged")),
    Spoilt("true shape missing", lambda scan: (scan / "dataset/truth/specimen.ply").unlink(), ("specimen.ply", "does not exist")),
    Spoilt("no truth, as imported", lambda scan: shutil.rmtree(scan / "dataset/truth"), ("dataset", "no truth", "only simulated")),
    Spoilt("no dataset", lambda scan: shutil.rmtree(scan / "dataset"), ("dataset", "no such folder")),
    Spoilt(
        "another dataset",
        lambda scan: replace_text(scan / "dataset/dataset.json", '"name": "sphere_20mm"', '"name": "other"'),
        ("sphere_20mm", "other", "give the dataset"),
    ),
]


@pytest.mark.parametrize("spoilt", SCORED, ids=lambda spoilt: spoilt.name)
def test_score(spoilt: Spoilt, scan: Path, command: Any) -> None:
    spoilt.spoil(scan)
    done = command.fails("score", scan / "result", scan / "dataset", "--json", named=spoilt.named)
    assert done.out == ""


@pytest.mark.parametrize("words", ["simulate sphere_20mm", "reconstruct dataset"])
def test_no_llvm(words: str, dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: Any) -> None:
    from rhizotwin import engine

    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("DRJIT_LIBLLVM_PATH", raising=False)
    monkeypatch.setattr(engine, "usual_folders", lambda: [tmp_path])
    command.fails(*words.split(), "-o", "out", "--device", "cpu", named=["no LLVM", "17 or newer", "install"])
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", str(dataset / "libLLVM-19.so"))
    command.fails(*words.split(), "-o", "out", "--device", "cpu", named=["libLLVM-19.so is no file", "unset it"])
    nothing_left(tmp_path, "dataset")
