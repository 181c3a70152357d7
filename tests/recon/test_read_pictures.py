"""Which pictures of a dataset are read, and what becomes of those that are not."""

from collections.abc import Callable

import pytest

from rhizotwin.recon.calibration.cameras import Camera, Cameras
from rhizotwin.recon.optics.refraction import Optics
from rhizotwin.recon.read_pictures import read_pictures
from rhizotwin.recon.settings import PictureSettings
from rhizotwin.scenes.dataset import load_dataset
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.monitor import Monitor


def read(scan: Callable, **settings):
    return read_pictures(load_dataset(scan.dataset), settings=PictureSettings(**settings), monitor=Monitor())


def test_unread_pictures_are_named_with_their_reason(scan: Callable) -> None:
    made = scan()
    (made.dataset / "images" / "view_001.png").unlink()
    with pytest.raises(UserError, match=r"view_001\.png: the picture is missing"):
        read(made)
    found = read(made, tolerant=True, leave_out=("view_003.png",))
    assert [frame.file for frame in found.frames] == [f"images/view_00{k}.png" for k in (0, 2, 4, 5)]
    assert [(frame.file[-5], reason.partition(";")[0].rpartition(": ")[2]) for frame, reason in found.left_out] == [
        ("3", "it is named in --leave-out or in the setting pictures.leave_out"),
        ("1", "the picture is missing"),
    ]
    assert found.warnings[0] == "images/view_003.png is excluded: it is named in --leave-out or in the setting pictures.leave_out"
    cameras = Cameras(
        lens=found.dataset.scene.camera,
        optics=Optics.from_scene(found.dataset.scene),
        all=tuple(Camera(file=frame.file, ring=0, used=True) for frame in found.frames),
        order=(0, 1, 2, 3),
    ).leave_out({2: "it is dark"}, unread=found.left_out)
    assert cameras.order == (0, 1, 3)
    assert [(camera.file[-5], camera.used) for camera in cameras.all] == [(k, k in "025") for k in "024531"]


def test_pictures_that_are_not_there_are_refused(scan: Callable) -> None:
    made = scan()
    with pytest.raises(UserError, match=r"--leave-out view_9\.png: .* lists no picture with this name"):
        read(made, leave_out=("view_9.png",))
    with pytest.raises(UserError, match="all root pictures are excluded"):
        read(made, leave_out=tuple(f"view_00{k}.png" for k in range(6)))


def test_settings_and_options_are_joined() -> None:
    joined = PictureSettings(leave_out=("a.png",)).joined(PictureSettings(leave_out=("b.png",), tolerant=True))
    assert joined == PictureSettings(leave_out=("a.png", "b.png"), tolerant=True)
