"""The dataset folder and its truth: round trips, and damage named."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rhizotwin.scenes import frames
from rhizotwin.scenes.atomic import write_image
from rhizotwin.scenes.dataset import Dataset, Frame, file_sha256, load_dataset, read_image, save_dataset
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Camera, CapturePlan, Ring, Scene
from rhizotwin.scenes.specimens import GrownSpecimen
from rhizotwin.scenes.truth import TrueView, Truth, load_truth, save_truth

POSE = frames.from_rotvec(np.array([0.1, -2.0, 0.3]), np.array([1 / 3, 2e-9, 400.0]))


def nested(a_from_b: frames.Array) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(float(v) for v in row) for row in a_from_b)


@pytest.fixture
def dataset(tmp_path: Path) -> Dataset:
    made = []
    for k in range(2):
        path = tmp_path / "images" / f"{k}.png"
        write_image(path, np.full((16, 20), 1000 * k + 7, np.uint16))
        made.append(Frame(file=f"images/{k}.png", sha256=file_sha256(path), table_deg=9.1 * k, cam_from_canister=nested(POSE)))
    made[1] = replace(made[1], kind="shoot", ring=1, table_read_deg=0.1 + 0.2, joints_deg=(1.0, 2.5), exposure_s=1e-3, time_s=2.0)
    camera, plan = Camera(image_wh=(20, 16), principal_px=(9.5, 7.5)), CapturePlan(rings=(Ring(), Ring()))
    scene = Scene(camera=camera, plan=plan, specimen=GrownSpecimen())
    return Dataset(folder=tmp_path, scene=scene, frames=tuple(made), seed=0, origin={"profile": "bench", "versions": {"x": "1"}})


def edit(folder: Path, change: Callable[[Any], None], file: str = "dataset.json") -> None:
    plain = json.loads((folder / file).read_text())
    change(plain)
    (folder / file).write_text(json.dumps(plain))


def test_dataset_and_pictures_survive(dataset: Dataset) -> None:
    saved = save_dataset(dataset)
    loaded = load_dataset(str(dataset.folder))
    assert loaded == dataset
    assert loaded.frames[1].cam_from_canister == nested(POSE)
    assert loaded.sha256 == saved.sha256 == file_sha256(dataset.folder / "dataset.json")
    images = np.stack([read_image(loaded, frame) for frame in loaded.frames])
    assert images.dtype == np.uint16
    np.testing.assert_array_equal(images, np.broadcast_to([[[7]], [[1007]]], (2, 16, 20)))


def of_frame(number: int, **changes: Any) -> Callable[[Any], None]:
    return lambda plain: plain["frames"][number].update(changes)


DAMAGES: dict[str, tuple[Callable[[Any], Any], str]] = {
    "newer version": (lambda d: d.update(schema_version=2), r"dataset\.json has version 2, but this program reads version 1"),
    "unknown key": (lambda d: d.update(frams=[]), 'frams: unknown key.*"frames"'),
    "impossible scene": (lambda d: d["scene"]["water"].update(n_water=9), r"\[scene\.water\] n_water = 9: must be between 1 and 2"),
    "path out of the folder": (of_frame(0, file="../a.png"), r"\[frames 1\] file = .*inside the dataset"),
    "name that moves the cursor": (of_frame(0, file="images/\x1b[2J.png"), r"\[frames 1\] file.* must consist of printable characters"),
    "frame twice": (of_frame(1, file="images/0.png"), r"\[frames 2\] file = .*twice"),
    "same stem": (of_frame(1, file="more/0.jpg"), r"\[frames 2\] file = \"more/0.jpg\": .*images/0\.png.* rename"),
    "pose for some only": (of_frame(0, cam_from_canister=None), r"is missing for images/0\.png, but images/1\.png has a pose"),
    "stretched pose": (lambda d: d["frames"][1]["cam_from_canister"][0].__setitem__(0, 3.0), "a rotation and a translation"),
}
"""Changes of dataset.json, and what the message must say."""


@pytest.mark.parametrize(("change", "says"), DAMAGES.values(), ids=DAMAGES)
def test_damaged_manifest_is_named(dataset: Dataset, change: Callable[[Any], Any], says: str) -> None:
    save_dataset(dataset)
    edit(dataset.folder, change)
    with pytest.raises(UserError, match=says) as caught:
        load_dataset(dataset.folder)
    assert "dataset.json" in str(caught.value)
    assert str(caught.value).isprintable()


@pytest.mark.parametrize("text", ['{"schema_version": 1', "[]", "[" * 100000], ids=["cut", "list", "deep"])
def test_manifest_that_is_no_json_or_missing(dataset: Dataset, tmp_path: Path, text: str) -> None:
    (dataset.folder / "dataset.json").write_text(text)
    with pytest.raises(UserError, match=r"dataset\.json: the file is damaged"):
        load_dataset(dataset.folder)
    with pytest.raises(UserError, match="no such folder"):
        load_dataset(tmp_path / "nothing")
    with pytest.raises(UserError, match=r"has no dataset\.json"):
        load_dataset(tmp_path / "images")


SPOILT: dict[str, tuple[Callable[[Path], Any], str]] = {
    "missing": (Path.unlink, "the picture is missing"),
    "truncated": (lambda path: path.write_bytes(path.read_bytes()[:-20]), "the picture is truncated"),
    "other size": (lambda path: write_image(path, np.zeros((20, 16), np.uint8)), "the picture has 16x20 pixels, but .* image_wh 20x16"),
    "exchanged": (lambda path: write_image(path, np.zeros((16, 20), np.uint8)), "differs from the recorded picture"),
}


@pytest.mark.parametrize(("spoil", "says"), SPOILT.values(), ids=SPOILT)
def test_spoilt_picture_is_named(dataset: Dataset, spoil: Callable[[Path], Any], says: str) -> None:
    spoil(dataset.folder / "images/1.png")
    with pytest.raises(UserError, match=rf"1\.png: .*{says}"):
        read_image(dataset, dataset.frames[1])
    if says.startswith("differs"):
        assert not read_image(dataset, replace(dataset.frames[1], sha256="")).any(), "without a recorded hash it is read"


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


def test_truth_survives_and_damage_is_named(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"has no truth/truth\.json"):
        load_truth(tmp_path)
    save_truth(tmp_path, TRUTH)
    assert load_truth(tmp_path) == TRUTH
    edit(tmp_path, lambda d: d.update(volume_mm3=None), "truth/truth.json")
    with pytest.raises(UserError, match=r"truth\.json: volume_mm3 = None: must be a number"):
        load_truth(tmp_path)
