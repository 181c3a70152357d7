"""What the commands say to input that cannot be used: one sentence that names it, an exit code, nothing left behind.

Each class of input is spoilt once here; every way to spoil it is tried where the decision is made: in the tests of scenes, sim and recon.
"""

import json
import shutil
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import trimesh

from rhizotwin.scenes.atomic import write_image
from tests.command import Command

pytestmark = pytest.mark.slow

AT_THE_SIDE = [[0.0, 0.0, 1.0, 400.0], [1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, -60.0], [0.0, 0.0, 0.0, 1.0]]
"""A camera that looks at the canister, with the axes of transforms.json."""
FAST = ("--device", "cpu", "--voxel-mm", "2")


def nothing_left(folder: Path, *known: str) -> None:
    """Check that a folder holds these names and nothing else, and no temporary file anywhere."""
    assert sorted(path.name for path in folder.iterdir()) == sorted(known)
    assert not [path for path in folder.rglob("*") if path.name.endswith(".tmp")]


def picture(dataset: Path, k: int) -> Path:
    return dataset / "images" / f"view_{k:03d}.png"


def read(path: Path) -> np.ndarray:
    return np.asarray(cv2.imread(str(path), cv2.IMREAD_UNCHANGED))


def cut(path: Path) -> None:
    data = path.read_bytes()
    path.write_bytes(data[: 6 * len(data) // 10])


def test_what_is_to_be_imported(made: Path, rig: Path, tmp_path: Path, command: Command) -> None:
    words, cameras = ("--scene", rig, "-o", tmp_path / "out"), tmp_path / "transforms.json"
    pictures = Path(shutil.copytree(made / "images", tmp_path / "pictures"))
    cut(pictures / "view_003.png")
    command.fails("import", pictures, *words, named=["view_003.png", "truncated"])
    write_image(pictures / "view_003.png", np.zeros((238, 316), np.uint8))
    command.fails("import", pictures, *words, named=["view_003.png", "316x238", "320x240", "image_wh"])
    for path in pictures.iterdir():
        path.unlink()
    command.fails("import", pictures, *words, named=["pictures", "contains no picture"])
    cameras.write_text('{"fl_x": 1300.0, "frames": [')
    command.fails("import", made / "images", "--cameras", cameras, *words, named=[cameras, "not JSON"])
    nothing_left(tmp_path, "pictures", "transforms.json")


def change_manifest(dataset: Path, **strip: Any) -> None:
    """Change the strip of a scene; pictures may differ from the recorded ones then."""
    content = json.loads((dataset / "dataset.json").read_text(encoding="utf-8"))
    for frame in content["frames"]:
        frame["sha256"] = ""
    content["scene"]["strip"].update(strip)
    (dataset / "dataset.json").write_text(json.dumps(content), encoding="utf-8")


def paint(dataset: Path, k: int, part: tuple[slice, ...], light: int | None = None) -> None:
    pixels = read(picture(dataset, k))
    pixels[part] = pixels.max() if light is None else light
    write_image(picture(dataset, k), pixels)


STRIP, WATER = np.s_[:72, :], np.s_[76:, :]


def test_views_with_few_markers_or_no_root_are_named(dataset: Path, tmp_path: Path, command: Command) -> None:
    paint(dataset, 2, STRIP)
    paint(dataset, 5, np.s_[:72, 90:])
    below, pixels = np.s_[80:], read(picture(dataset, 4))
    empty = np.stack([read(path) for path in sorted((dataset / "images").iterdir())]).max(axis=0)
    assert (pixels[below] < 0.5 * empty[below]).any()
    pixels[below] = empty[below]
    write_image(picture(dataset, 4), pixels)
    change_manifest(dataset)
    words = ("reconstruct", dataset, "-o", tmp_path / "result", *FAST)
    command.fails(*words, named=["view_004.png", "empty silhouette (1 of 8", "--leave-out"])
    done = command.works(*words, "--leave-out", "view_004.png")
    warnings = [line for line in done.out.splitlines() if line.startswith("warning: ") and "is excluded" in line]
    assert any("view_002.png is excluded: no markers were found" in line for line in warnings), done.out
    few = "only 2 markers were found, at least 4 are needed"
    assert any("view_005.png is excluded: " in line and few in line for line in warnings), done.out
    assert "7 of 10 views used" in done.out, done.out
    nothing_left(tmp_path, "dataset", "result")


SPOILT: dict[str, tuple[range, tuple[slice, ...], int | None, dict[str, Any], list[str]]] = {
    "two views left": (range(8), STRIP, None, {}, ["only 2 of 10", "at least 3", "view_000.png: no markers were found"]),
    "no backlight": (range(10), WATER, 0, {}, ["view_000.png", "the ground is dark", "panel was off"]),
    # a part of the markers has ids that the scene's strip has too: their poses would be wrong
    "first id": (range(0), STRIP, None, {"first_id": 13}, ["images/view_00", "markers of another strip", "13 to 74"]),
}
"""Views whose part is painted over in a light, changes of the strip, and what is named."""


@pytest.mark.parametrize(("views", "part", "light", "strip", "named"), SPOILT.values(), ids=SPOILT)
def test_scans_without_use(
    views: range, part: Any, light: int | None, strip: Any, named: list[str], dataset: Path, tmp_path: Path, command: Command
) -> None:  # fmt: skip
    for k in views:
        paint(dataset, k, part, light)
    change_manifest(dataset, **strip)
    command.fails("reconstruct", dataset, "-o", tmp_path / "result", *FAST, named=named)
    nothing_left(tmp_path, "dataset")


def test_empty_masks(rig: Path, tmp_path: Path, command: Command) -> None:
    (tmp_path / "masks").mkdir()
    for k in range(4):
        write_image(tmp_path / "masks" / f"{k}.png", np.zeros((240, 320), np.uint8))
    words = ("import", tmp_path / "masks", "--masks", "--scene", rig, "-o", tmp_path / "out")
    command.fails(*words, named=["--masks", "--cameras"])
    cameras = tmp_path / "cameras.json"
    frames = [{"file_path": f"{k}.png", "transform_matrix": AT_THE_SIDE} for k in range(4)]
    cameras.write_text(json.dumps({"fl_x": 520.0, "cx": 160.0, "cy": 120.0, "w": 320, "h": 240, "frames": frames}))
    command.fails(*words, "--cameras", cameras, named=["0.png", "is completely black"])
    nothing_left(tmp_path, "masks", "cameras.json")


def test_what_is_no_regular_file_or_too_much_is_not_read(
    found: Any, tmp_path: Path, command: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    trimesh.creation.icosphere(subdivisions=2, radius=8.0).export(tmp_path / "many.stl")
    monkeypatch.setattr("rhizotwin.sim.meshes.MOST_FACES", 100)
    monkeypatch.setattr("rhizotwin.stored.result_files.MOST_SHAPE_MIB", 0)
    with (tmp_path / "huge.rsml").open("wb") as stream:
        stream.truncate(2**36)
    end = ("--views", "1", "-o", tmp_path / "out", "--device", "cpu")
    command.fails("simulate", "/dev/full", *end, named=["/dev/full", "pipe or device"])
    command.fails("simulate", "sphere_20mm", "--specimen", tmp_path / "huge.rsml", *end, named=["huge.rsml", "65536 MiB", "32 MiB"])
    command.fails("simulate", "sphere_20mm", "--specimen", tmp_path / "many.stl", *end, named=["many.stl", "triangles", "simplify"])
    command.fails("export", found.folder, "-o", tmp_path / "a.nrrd", named=["shape.npz", "unpacked", "larger voxels"])
    nothing_left(tmp_path, "many.stl", "huge.rsml")


def test_places_that_cannot_be_written_are_named_at_once(tmp_path: Path, command: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "loop").symlink_to("loop")
    simulate = ("simulate", "sphere_20mm", "--device", "cpu", "-o")
    command.fails(*simulate, tmp_path / "loop" / "out", named=["loop", "is not a valid path"])
    command.fails(*simulate, tmp_path / ("d/" * 2000), named=["--output", "nested folders", "250"])
    monkeypatch.setattr("shutil.disk_usage", lambda _: shutil._ntuple_diskusage(2**30, 2**30 - 300_000, 300_000))
    monkeypatch.setattr("rhizotwin.sim.simulate.draw_world", None)
    command.fails(*simulate, tmp_path / "out", named=["out", "the disk is full"])
    nothing_left(tmp_path, "loop")


def test_result_folder_with_other_content(scan: Path, command: Command) -> None:
    result = scan / "result"
    (result / "notes.txt").write_text("years of work")
    command.fails("reconstruct", scan / "dataset", "-o", result, *FAST, named=[result, "notes.txt", "choose a new folder"])
    assert (result / "notes.txt").read_text() == "years of work"
    (result / "result.json").unlink()
    command.fails("reconstruct", scan / "dataset", "-o", result, *FAST, named=[result, "is not a result", "choose a new folder"])
    command.fails("reconstruct", scan / "dataset", "-o", scan / "dataset", *FAST, named=[scan / "dataset", "is not a result"])
    command.fails("simulate", "sphere_20mm", "-o", result, "--device", "cpu", named=[f"{result} contains files that are not"])
    words = ("simulate", "printed_8ml", "-o", scan / "dataset", "--device", "cpu")
    command.fails(*words, named=[scan / "dataset", "different settings", "scene", "choose a new folder"])
    nothing_left(scan, "dataset", "result")
    assert (result / "notes.txt").read_text() == "years of work"


def test_score_without_the_truth(scan: Path, command: Command) -> None:
    shutil.rmtree(scan / "dataset" / "truth")
    words = ("score", scan / "result", scan / "dataset", "--json")
    assert command.fails(*words, named=[scan / "dataset", "no ground truth", "use a simulated dataset"]).out == ""
