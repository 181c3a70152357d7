"""What is on the disk at every moment of a scan, and what is taken up."""

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rhizotwin.rig.rig_file import ArmPart, RigFile
from rhizotwin.rig.scanning import session as session_module
from rhizotwin.rig.scanning.session import Session, file_of, take_up
from rhizotwin.scenes import plan
from rhizotwin.scenes.dataset import Frame, load_dataset, read_image, save_dataset
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.folders import LOCK, held
from rhizotwin.scenes.model import Camera, CapturePlan, Ring, Scene
from rhizotwin.scenes.pictures import decode_grey, encode_png

SCENE = Scene(camera=Camera().resized((64, 48)), plan=CapturePlan(rings=(Ring(views=4),)))
VIEWS = plan.views(SCENE)
RIG = RigFile(arm=ArmPart())


def begin(folder: Path, **changes: Any) -> Session:
    options = {"rig": RIG, "settings": {"twin": None}, "seed": None} | changes
    scene = options.pop("scene", SCENE)
    return take_up(folder, scene, plan.views(scene), **options)


def picture(index: int) -> np.ndarray:
    return np.random.default_rng(index).integers(0, 65536, (48, 64)).astype(np.uint16)


def frame(index: int, **changes: Any) -> Frame:
    view = VIEWS[index]
    return Frame(file=file_of(view), sha256="", ring=view.ring, kind=view.kind, table_deg=view.table_deg, time_s=float(index), **changes)


def taken(folder: Path, *indices: int) -> None:
    made = begin(folder)
    for index in indices:
        made.record(frame(index), picture(index))
    made.save()
    made.close()


def test_frames_are_listed_with_the_hash_of_what_is_on_the_disk(tmp_path: Path) -> None:
    taken(tmp_path / "d", 0, 1)
    dataset = load_dataset(tmp_path / "d")
    assert [frame.file for frame in dataset.frames] == ["images/view_000.png", "images/view_001.png"]
    assert all(np.array_equal(read_image(dataset, frame), picture(k)) for k, frame in enumerate(dataset.frames))
    assert not dataset.origin["complete"]


def test_the_list_is_written_before_the_picture(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    order: list[str] = []
    monkeypatch.setattr(session_module, "write_bytes", lambda path, _: order.append(path.name))
    monkeypatch.setattr(session_module, "save_dataset", lambda dataset: order.append(f"list of {len(dataset.frames)}"))
    made = begin(tmp_path / "d")
    made.record(frame(0), picture(0))
    made.record(frame(1), picture(1))
    made.close()
    assert order == ["list of 1", "view_000.png", "list of 2", "view_001.png"]


def test_a_listed_frame_without_its_picture_is_taken_again(tmp_path: Path) -> None:
    taken(tmp_path / "d", 0, 1, 2)
    (tmp_path / "d" / "images" / "view_001.png").unlink()
    made = begin(tmp_path / "d", resume=True)
    assert [view.index for view in made.remaining()] == [1, 3]
    made.record(frame(3, placement=1), picture(3))
    made.record(frame(1, placement=1), picture(1))
    assert [frame.file for frame in made.save(complete=True).frames] == [file_of(view) for view in VIEWS]
    made.close()
    assert load_dataset(tmp_path / "d").origin["complete"]


def test_placements_and_time_go_on(tmp_path: Path) -> None:
    taken(tmp_path / "d", 0, 1)
    made = begin(tmp_path / "d", resume=True)
    assert (made.next_placement(0), made.next_placement(1)) == (1, 0)
    assert made.begun_s == 1.0
    made.close()


def test_a_picture_that_is_not_the_recorded_one_is_named(tmp_path: Path) -> None:
    taken(tmp_path / "d", 0)
    (tmp_path / "d" / "images" / "view_000.png").write_bytes(encode_png(picture(9)))
    with pytest.raises(UserError, match=r"view_000\.png: is not the picture that was recorded; remove it"):
        begin(tmp_path / "d", resume=True)


@dataclass(frozen=True)
class Difference:
    """Something that is not as it was when the scan was begun, and how it must be named."""

    named: str
    changes: dict[str, Any]


DIFFERENCES = [
    Difference("scene.plan.rings", {"scene": replace(SCENE, plan=CapturePlan(rings=(Ring(views=4), Ring(views=2))))}),
    Difference("scene.plan.rings.1.views", {"scene": replace(SCENE, plan=CapturePlan(rings=(Ring(views=5),)))}),
    Difference("scene.water.n_water", {"scene": replace(SCENE, water=replace(SCENE.water, n_water=1.334))}),
    Difference("scene.camera.distortion.1", {"scene": replace(SCENE, camera=replace(SCENE.camera, distortion=(0.1, 0.0, 0.0, 0.0, 0.0)))}),
    Difference("rig.camera.exposure_s", {"rig": replace(RIG, camera=replace(RIG.camera, exposure_s=0.02))}),
    Difference("rig.arm", {"rig": replace(RIG, arm=None)}),
    Difference("twin", {"settings": {"twin": {"profile": "bench"}}}),
    Difference("seed", {"seed": 3}),
]


@pytest.mark.parametrize("difference", DIFFERENCES, ids=lambda difference: difference.named)
def test_differences_are_refused_by_name(difference: Difference, tmp_path: Path) -> None:
    taken(tmp_path / "d", 0)
    with pytest.raises(UserError, match=f"begun with another {difference.named}: give the same"):
        begin(tmp_path / "d", resume=True, **difference.changes)


def test_many_differences_are_named_shortly(tmp_path: Path) -> None:
    taken(tmp_path / "d", 0)
    other = replace(SCENE, canister=replace(SCENE.canister, outer_radius_mm=70.0, wall_mm=3.0, height_mm=150.0, base_mm=5.0, n_wall=1.5))
    with pytest.raises(UserError, match=r"scene\.canister\.outer_radius_mm, .* and more"):
        begin(tmp_path / "d", resume=True, scene=other)


def test_a_device_that_was_plugged_in_again_may_have_another_port(tmp_path: Path) -> None:
    taken(tmp_path / "d", 0)
    moved = replace(RIG, turntable=replace(RIG.turntable, port="/dev/ttyUSB7"), arm=replace(RIG.arm, port="/dev/ttyACM3"), name="renamed")
    made = begin(tmp_path / "d", resume=True, rig=moved)
    assert len(made.remaining()) == 3
    made.close()


def test_folders_that_cannot_be_used(tmp_path: Path) -> None:
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "notes.txt").write_text("x")
    with pytest.raises(UserError, match="not empty and holds no stopped scan"):
        begin(tmp_path / "other", resume=True)
    taken(tmp_path / "d", 0)
    with pytest.raises(UserError, match="stopped after 1 pictures: add --resume"):
        begin(tmp_path / "d")
    dataset = load_dataset(tmp_path / "d")
    save_dataset(replace(dataset, origin={"program": "rhizotwin simulate"}))
    with pytest.raises(UserError, match="was not made by scanning"):
        begin(tmp_path / "d", resume=True)


def test_what_a_killed_scan_left_half_written_is_removed(tmp_path: Path) -> None:
    taken(tmp_path / "d", 0)
    left = [tmp_path / "d" / ".dataset.json.77-ab12cd34.tmp", tmp_path / "d" / "images" / ".view_001.png.77-ab12cd34.tmp"]
    for path in left:
        path.write_bytes(b"half")
    (tmp_path / "d" / LOCK).write_text('{"pid": 77, "host": "bench", "since": "yesterday"}')
    with held(tmp_path / "d"):
        begin(tmp_path / "d", resume=True).close()
        assert not any(path.exists() for path in left)


def test_pictures_that_turned_out_wrong_are_taken_out(tmp_path: Path) -> None:
    made = begin(tmp_path / "d")
    for index in (0, 1):
        made.record(frame(index), picture(index))
    made.drop(["images/view_001.png"])
    assert [frame.file for frame in load_dataset(tmp_path / "d").frames] == ["images/view_000.png"]
    assert not (tmp_path / "d" / "images" / "view_001.png").exists()
    made.drop(["images/view_000.png"])
    assert not (tmp_path / "d" / "dataset.json").exists()
    assert len(made.remaining()) == 4
    made.close()


def test_failure_to_write_is_raised_with_the_next_picture(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made = begin(tmp_path / "d")

    def full(path: Path, _: bytes) -> None:
        raise UserError(f"{path}: the disk is full")

    monkeypatch.setattr(session_module, "write_bytes", full)
    made.record(frame(0), picture(0))
    with pytest.raises(UserError, match=r"view_000\.png: the disk is full"):
        made.record(frame(1), picture(1))
    monkeypatch.undo()
    made.close()
    assert [view.index for view in begin(tmp_path / "d", resume=True).remaining()] == [0, 1, 2, 3]


def test_what_stands_in_the_canister_is_not_told(tmp_path: Path) -> None:
    scene = replace(SCENE, description="a secret root")
    made = begin(tmp_path / "d", scene=scene)
    made.record(frame(0), picture(0))
    made.close()
    assert "secret" not in (tmp_path / "d" / "dataset.json").read_text()
    assert json.loads((tmp_path / "d" / "dataset.json").read_text())["scene"]["specimen"] is None


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_png_keeps_every_bit(dtype: type) -> None:
    image = np.random.default_rng(1).integers(0, np.iinfo(dtype).max, (30, 40), endpoint=True).astype(dtype)
    assert np.array_equal(decode_grey(encode_png(image), where="x"), image)
