"""The dataset folder and its truth: round trips, and damage named."""

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rhizotwin.scenes import frames
from rhizotwin.scenes.atomic import write_image
from rhizotwin.scenes.dataset import Dataset, Frame, load_dataset, read_image, save_dataset, sha256_of
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Camera, CapturePlan, Ring, Scene
from rhizotwin.scenes.specimens import GrownSpecimen
from rhizotwin.scenes.truth import TrueView, Truth, load_truth, save_truth

POSE = frames.from_rotvec(np.array([0.1, -2.0, 0.3]), np.array([1 / 3, 2e-9, 400.0]))


def nested(a_from_b: frames.Array) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(float(v) for v in row) for row in a_from_b)


@pytest.fixture
def dataset(tmp_path: Path) -> Dataset:
    """Two tiny pictures on the disk, with poses."""
    made = []
    for k in range(2):
        write_image(tmp_path / "images" / f"{k}.png", np.full((16, 20), 1000 * k + 7, np.uint16))
        made.append(
            Frame(
                file=f"images/{k}.png",
                sha256=sha256_of(tmp_path / "images" / f"{k}.png"),
                table_deg=9.1 * k,
                cam_from_canister=nested(POSE),
            )
        )
    made[1] = replace(
        made[1],
        kind="shoot",
        ring=1,
        table_read_deg=0.1 + 0.2,
        joints_deg=(1.0, 2.5),
        exposure_s=1e-3,
        time_s=2.0,
    )
    scene = Scene(
        camera=Camera(image_wh=(20, 16), principal_px=(9.5, 7.5)), plan=CapturePlan(rings=(Ring(), Ring())), specimen=GrownSpecimen()
    )
    return Dataset(folder=tmp_path, scene=scene, frames=tuple(made), seed=0, origin={"profile": "bench", "versions": {"x": "1"}})


def edit(folder: Path, change: Callable[[Any], None], file: str = "dataset.json") -> None:
    plain = json.loads((folder / file).read_text())
    change(plain)
    (folder / file).write_text(json.dumps(plain))


def test_dataset_survives(dataset: Dataset) -> None:
    save_dataset(dataset)
    assert load_dataset(dataset.folder) == dataset
    assert load_dataset(str(dataset.folder)).frames[1].cam_from_canister == nested(POSE)
    without = replace(dataset, frames=tuple(replace(frame, cam_from_canister=None) for frame in dataset.frames))
    save_dataset(without)
    assert load_dataset(dataset.folder) == without


def test_pictures_are_read_as_written(dataset: Dataset) -> None:
    for k, frame in enumerate(dataset.frames):
        image = read_image(dataset, frame)
        assert image.dtype == np.uint16
        np.testing.assert_array_equal(image, np.full((16, 20), 1000 * k + 7))


@dataclass(frozen=True)
class Damage:
    """A change of dataset.json, and what the message must say."""

    id: str
    change: Callable[[Any], Any]
    says: str


DAMAGES = [
    Damage("newer version", lambda d: d.update(schema_version=2), r"dataset\.json has version 2; this program reads 1"),
    Damage("version as text", lambda d: d.update(schema_version="1"), r"has version 1; this program reads 1"),
    Damage("no version", lambda d: d.pop("schema_version"), "has no schema_version"),
    Damage("no scene", lambda d: d.pop("scene"), "scene: is missing"),
    Damage("unknown key", lambda d: d.update(frams=[]), 'frams: unknown key.*"frames"'),
    Damage("no frames", lambda d: d.update(frames=[]), "at least one"),
    Damage("impossible scene", lambda d: d["scene"]["water"].update(n_water=9), r"\[scene\.water\] n_water = 9: must be between 1 and 2"),
    Damage("misfit scene", lambda d: d["scene"]["canister"].update(wall_mm=50.0, outer_radius_mm=20.0), r"\[canister\] wall_mm"),
    Damage("frame without a file", lambda d: d["frames"][1].pop("file"), r"\[frames 2\] file: is missing"),
    Damage("path out of the folder", lambda d: d["frames"][0].update(file="../a.png"), r"\[frames 1\] file = .*inside the dataset"),
    Damage("absolute path", lambda d: d["frames"][0].update(file="/a.png"), "inside the dataset"),
    Damage("frame twice", lambda d: d["frames"][1].update(file="images/0.png"), r"\[frames 2\] file = .*twice"),
    Damage(
        "same stem", lambda d: d["frames"][1].update(file="more/0.jpg"), r"\[frames 2\] file = \"more/0.jpg\": .*images/0\.png.* rename"
    ),
    Damage(
        "pose for some only",
        lambda d: d["frames"][0].update(cam_from_canister=None),
        r"\[frames 1\] cam_from_canister: is missing for images/0\.png, but images/1\.png has one",
    ),
    Damage("short hash", lambda d: d["frames"][0].update(sha256="abc"), "64 hexadecimal"),
    Damage("unknown kind", lambda d: d["frames"][0].update(kind="leaf"), '"root", "shoot"'),
    Damage("ring that is not in the plan", lambda d: d["frames"][0].update(ring=2), "between 0 and 1"),
    Damage("pose of three rows", lambda d: d["frames"][1]["cam_from_canister"].pop(), "4 rows of 4"),
    Damage("pose that is stretched", lambda d: d["frames"][1]["cam_from_canister"][0].__setitem__(0, 3.0), "a rotation and a shift"),
    Damage("mirrored pose", lambda d: d["frames"][1].update(cam_from_canister=np.diag([1.0, 1, -1, 1]).tolist()), "mirror image"),
    Damage("angle as text", lambda d: d["frames"][1].update(table_deg="9"), r"\[frames 2\] table_deg = \"9\": must be a number"),
]


@pytest.mark.parametrize("damage", DAMAGES, ids=lambda d: d.id)
def test_damaged_manifest_is_named(dataset: Dataset, damage: Damage) -> None:
    save_dataset(dataset)
    edit(dataset.folder, damage.change)
    with pytest.raises(UserError, match=damage.says) as caught:
        load_dataset(dataset.folder)
    assert "dataset.json" in str(caught.value)


@pytest.mark.parametrize("text", ["", "{", '{"schema_version": 1', "[]", "nul", "[" * 100000, "\x00"])
def test_truncated_manifest(dataset: Dataset, text: str) -> None:
    (dataset.folder / "dataset.json").write_text(text)
    with pytest.raises(UserError, match=r"dataset\.json: is damaged"):
        load_dataset(dataset.folder)


def test_folder_without_manifest(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="no such folder"):
        load_dataset(tmp_path / "nothing")
    with pytest.raises(UserError, match=r"has no dataset\.json"):
        load_dataset(tmp_path)


def test_missing_picture(dataset: Dataset) -> None:
    (dataset.folder / "images/1.png").unlink()
    with pytest.raises(UserError, match=r"1\.png: the picture is missing"):
        read_image(dataset, dataset.frames[1])


def test_truncated_picture(dataset: Dataset) -> None:
    path = dataset.folder / "images/1.png"
    path.write_bytes(path.read_bytes()[:-20])
    with pytest.raises(UserError, match=r"1\.png: the picture is truncated"):
        read_image(dataset, dataset.frames[1])


def test_picture_that_is_none(dataset: Dataset) -> None:
    (dataset.folder / "images/1.png").write_text("not here")
    with pytest.raises(UserError, match=r"1\.png: is not a picture"):
        read_image(dataset, dataset.frames[1])


def test_picture_of_another_size(dataset: Dataset) -> None:
    write_image(dataset.folder / "images/1.png", np.zeros((20, 16), np.uint8))
    with pytest.raises(UserError, match=r"1\.png: the picture is 16x20 pixels, but .* image_wh 20x16"):
        read_image(dataset, dataset.frames[1])


def test_exchanged_picture(dataset: Dataset) -> None:
    write_image(dataset.folder / "images/1.png", np.zeros((16, 20), np.uint8))
    with pytest.raises(UserError, match=r"1\.png: is not the picture that was recorded"):
        read_image(dataset, dataset.frames[1])
    assert not read_image(dataset, replace(dataset.frames[1], sha256="")).any()


def test_picture_that_is_a_folder(dataset: Dataset) -> None:
    (dataset.folder / "images/1.png").unlink()
    (dataset.folder / "images/1.png").mkdir()
    with pytest.raises(UserError, match=r"1\.png: the picture cannot be read"):
        read_image(dataset, dataset.frames[1])


def test_hash_of_a_known_file(tmp_path: Path) -> None:
    (tmp_path / "abc").write_bytes(b"abc")  # FIPS 180-2, appendix B.1
    assert sha256_of(tmp_path / "abc") == "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
    with pytest.raises(UserError, match="nothing: cannot be read"):
        sha256_of(tmp_path / "nothing")


TRUTH = Truth(
    volume_mm3=8000.0 / 3.0,
    extents_min_mm=(-1.0, -2.0, -90.1),
    extents_max_mm=(1.0, 2.0, -10.0),
    n_water=1.334,
    canister_from_strip=nested(np.eye(4)),
    views=(TrueView(file="images/0.png", cam_from_canister=nested(POSE), table_deg=0.1 + 0.2),),
    traits={"tips": 3.0},
    drawn={"seed": 1, "tilt": [0.5, None]},
)


def test_truth_survives(tmp_path: Path) -> None:
    save_truth(tmp_path, TRUTH)
    assert (tmp_path / "truth" / "truth.json").is_file()
    assert load_truth(tmp_path) == TRUTH


def test_damaged_truth_is_named(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"has no truth/truth\.json"):
        load_truth(tmp_path)
    save_truth(tmp_path, TRUTH)
    edit(tmp_path, lambda d: d.update(volume_mm3=None), "truth/truth.json")
    with pytest.raises(UserError, match=r"truth\.json: volume_mm3 = None: must be a number"):
        load_truth(tmp_path)
    edit(tmp_path, lambda d: d.update(schema_version=3), "truth/truth.json")
    with pytest.raises(UserError, match=r"truth\.json has version 3; this program reads 1"):
        load_truth(tmp_path)


@pytest.mark.parametrize("name", ["images/a\0.png", "images/\udcff.png", "images/\x1b[2J.png"], ids=ascii)
def test_names_that_cannot_be_shown_are_refused(dataset: Dataset, name: str) -> None:
    save_dataset(dataset)
    edit(dataset.folder, lambda plain: plain["frames"][0].update(file=name))
    with pytest.raises(UserError, match="must be a name of letters that can be shown") as said:
        load_dataset(dataset.folder)
    assert str(said.value).isprintable()


def test_the_hash_is_of_the_bytes_that_were_read(dataset: Dataset) -> None:
    saved = save_dataset(dataset)
    loaded = load_dataset(dataset.folder)
    assert loaded.sha256 == saved.sha256 == sha256_of(dataset.folder / "dataset.json")
    again = save_dataset(replace(loaded, seed=5))
    assert again.sha256 == sha256_of(dataset.folder / "dataset.json") != loaded.sha256
