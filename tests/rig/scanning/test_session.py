"""What is on the disk at every moment of a scan, and what is taken up."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rhizotwin.rig.rig_file import ArmPart, RigFile
from rhizotwin.rig.scanning.session import Origin, Session, open_session, picture_file
from rhizotwin.scenes import plan
from rhizotwin.scenes.dataset import Frame, load_dataset, read_image
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Camera, CapturePlan, Ring, Scene
from rhizotwin.scenes.picture_codec import encode_png

SCENE = Scene(camera=Camera().resized((64, 48)), plan=CapturePlan(rings=(Ring(views=4),)))
VIEWS = plan.views(SCENE)
RIG = RigFile(arm=ArmPart())


def begin(folder: Path, **changes: Any) -> Session:
    options = {"rig": RIG, "origin": Origin(settings={"twin": None})} | changes
    scene = options.pop("scene", SCENE)
    return open_session(folder, scene, plan.views(scene), **options)


def picture(index: int) -> np.ndarray:
    return np.random.default_rng(index).integers(0, 65536, (48, 64)).astype(np.uint16)


def frame(index: int, **changes: Any) -> Frame:
    view = VIEWS[index]
    return Frame(
        file=picture_file(view), sha256="", ring=view.ring, kind=view.kind, table_deg=view.table_deg, time_s=float(index), **changes
    )


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
    (tmp_path / "d" / "images" / "view_000.png").write_bytes(encode_png(picture(9)))
    with pytest.raises(UserError, match=r"view_000\.png differs from the recorded picture; remove it"):
        begin(tmp_path / "d", resume=True)


def test_a_listed_frame_without_its_picture_is_taken_again(tmp_path: Path) -> None:
    taken(tmp_path / "d", 0, 1, 2)
    (tmp_path / "d" / "images" / "view_001.png").unlink()
    made = begin(tmp_path / "d", resume=True)
    assert [view.index for view in made.remaining()] == [1, 3]
    assert (made.next_placement(0), made.next_placement(1), made.begun_s) == (1, 0, 2.0)
    made.record(frame(3, placement=1), picture(3))
    made.record(frame(1, placement=1), picture(1))
    assert [frame.file for frame in made.save(complete=True).frames] == [picture_file(view) for view in VIEWS]
    made.close()
    assert load_dataset(tmp_path / "d").origin["complete"]


DIFFERENCES = {
    "scene.plan.rings.1.views": {"scene": replace(SCENE, plan=CapturePlan(rings=(Ring(views=5),)))},
    "rig.camera.exposure_s": {"rig": replace(RIG, camera=replace(RIG.camera, exposure_s=0.02))},
    "twin": {"origin": Origin(settings={"twin": {"profile": "bench"}})},
    "seed": {"origin": Origin(settings={"twin": None}, seed=3)},
}
"""What is not as it was when the scan was begun, by how it must be named."""


def test_differences_are_refused_by_name_but_not_ports(tmp_path: Path) -> None:
    taken(tmp_path / "d", 0)
    for named, changes in DIFFERENCES.items():
        with pytest.raises(UserError, match=f"a scan with different values of {named}; use the same"):
            begin(tmp_path / "d", resume=True, **changes)
    with pytest.raises(UserError, match="interrupted after 1 picture; add --resume"):
        begin(tmp_path / "d")
    moved = replace(RIG, turntable=replace(RIG.turntable, port="/dev/ttyUSB7"), arm=replace(RIG.arm, port="/dev/ttyACM3"), name="renamed")
    made = begin(tmp_path / "d", resume=True, rig=moved)
    assert len(made.remaining()) == 3
    made.close()
    (tmp_path / "d" / "dataset.json").unlink()
    with pytest.raises(UserError, match="not empty and contains no interrupted scan"):
        begin(tmp_path / "d", resume=True)


def test_a_scan_is_resumed_after_an_update_of_the_rig_file(tmp_path: Path) -> None:
    taken(tmp_path / "d", 0)
    path = tmp_path / "d" / "dataset.json"
    plain = json.loads(path.read_text())
    del plain["origin"]["rig"]["turntable"]["rest"]
    path.write_text(json.dumps(plain))
    begin(tmp_path / "d", resume=True).close()
    plain["origin"]["rig"]["turntable"]["older"] = 1.0
    path.write_text(json.dumps(plain))
    with pytest.raises(UserError, match=r"different values of rig\.turntable\.older, rig\.turntable\.rest"):
        begin(tmp_path / "d", resume=True)


def test_pictures_that_turned_out_wrong_are_taken_out(tmp_path: Path) -> None:
    made = begin(tmp_path / "d", scene=replace(SCENE, description="a secret root"))
    for index in (0, 1):
        made.record(frame(index), picture(index))
    made.drop(["images/view_001.png"])
    assert [frame.file for frame in load_dataset(tmp_path / "d").frames] == ["images/view_000.png"]
    assert not (tmp_path / "d" / "images" / "view_001.png").exists()
    assert "secret" not in (tmp_path / "d" / "dataset.json").read_text()  # what stands in the canister
    made.drop(["images/view_000.png"])
    assert not (tmp_path / "d" / "dataset.json").exists()
    assert len(made.remaining()) == 4
    made.close()
