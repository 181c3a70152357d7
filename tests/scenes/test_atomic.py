"""Files and folders appear whole or not at all."""

import errno
import os
from pathlib import Path
from typing import Any, NoReturn

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from rhizotwin.scenes import atomic
from rhizotwin.scenes.errors import UserError


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def raising(error: BaseException) -> Any:
    def fail(*_: object, **__: object) -> NoReturn:
        raise error

    return fail


def fail_after_writing(folder: Path, error: BaseException) -> NoReturn:
    (folder / "a").write_text("x")
    raise error


def test_writes_and_makes_the_folder(tmp_path: Path) -> None:
    atomic.write_bytes(tmp_path / "a" / "b.bin", b"\x00\x01")
    assert (tmp_path / "a" / "b.bin").read_bytes() == b"\x00\x01"
    assert names(tmp_path / "a") == ["b.bin"]


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EDQUOT])
def test_full_disk_keeps_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int) -> None:
    path = tmp_path / "a.json"
    atomic.write_json(path, [1])
    monkeypatch.setattr(os, "fsync", raising(OSError(number, "full")))
    with pytest.raises(UserError, match=r"a\.json: the disk is full"):
        atomic.write_json(path, [2])
    assert path.read_text().split() == ["[", "1", "]"]
    assert names(tmp_path) == ["a.json"]


def test_interrupt_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "fsync", raising(KeyboardInterrupt()))
    with pytest.raises(KeyboardInterrupt):
        atomic.write_bytes(tmp_path / "a.bin", b"x")
    assert names(tmp_path) == []


def test_place_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(UserError, match=r"a\.bin: cannot be written"):
        atomic.write_bytes(tmp_path / "file" / "a.bin", b"x")
    (tmp_path / "folder").mkdir()
    with pytest.raises(UserError, match="folder: cannot be written"):
        atomic.write_bytes(tmp_path / "folder", b"x")
    assert names(tmp_path) == ["file", "folder"]


def test_json_refuses_what_json_has_not(tmp_path: Path) -> None:
    with pytest.raises(ValueError):
        atomic.write_json(tmp_path / "a.json", {"x": float("nan")})
    with pytest.raises(TypeError):
        atomic.write_json(tmp_path / "a.json", {"x": tmp_path})
    assert names(tmp_path) == []


@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_pictures_survive(tmp_path: Path, kind: type) -> None:
    grey = np.random.default_rng(0).integers(0, np.iinfo(kind).max, (5, 7), dtype=kind, endpoint=True)
    atomic.write_image(tmp_path / "a.png", grey)
    np.testing.assert_array_equal(cv2.imread(str(tmp_path / "a.png"), cv2.IMREAD_UNCHANGED), grey)
    colour: NDArray[Any] = np.zeros((2, 2, 3), kind)
    colour[..., 0] = 200  # red, which OpenCV keeps last
    atomic.write_image(tmp_path / "b.png", colour)
    np.testing.assert_array_equal(cv2.imread(str(tmp_path / "b.png"), cv2.IMREAD_UNCHANGED)[..., 2], colour[..., 0])


@pytest.mark.parametrize("image", [np.zeros((2, 2)), np.zeros((2, 2, 2), np.uint8), np.zeros(3, np.uint8), np.zeros((2, 2), bool)])
def test_what_is_no_picture_is_refused(tmp_path: Path, image: Any) -> None:
    with pytest.raises(ValueError, match="expected uint8 or uint16"):
        atomic.write_image(tmp_path / "a.png", image)


def test_folder_appears_when_done(tmp_path: Path) -> None:
    with atomic.new_folder(tmp_path / "deep" / "out") as building:
        atomic.write_bytes(building / "a", b"x")
        assert not (tmp_path / "deep" / "out").exists()
    assert names(tmp_path / "deep") == ["out"]
    assert names(tmp_path / "deep" / "out") == ["a"]


@pytest.mark.parametrize("error", [KeyboardInterrupt(), UserError("no"), RuntimeError()], ids=repr)
def test_folder_is_removed_on_failure(tmp_path: Path, error: BaseException) -> None:
    with pytest.raises(type(error)), atomic.new_folder(tmp_path / "out") as building:
        fail_after_writing(building, error)
    assert names(tmp_path) == []


def test_full_disk_inside_a_folder(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="out: the disk is full"), atomic.new_folder(tmp_path / "out"):
        raise OSError(errno.ENOSPC, "full")
    assert names(tmp_path) == []


def test_foreign_errors_pass_through_a_folder(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError), atomic.new_folder(tmp_path / "out"):
        (tmp_path / "nothing").read_bytes()


def test_folder_that_is_there(tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    with atomic.new_folder(out) as building:  # empty: taken
        (building / "a").write_text("1")
    with pytest.raises(UserError, match="exists already"), atomic.new_folder(out):
        pass
    with pytest.raises(RuntimeError), atomic.new_folder(out, replace=True):
        raise RuntimeError
    assert names(out) == ["a"]
    with atomic.new_folder(out, replace=True) as building:
        (building / "b").write_text("2")
    assert names(out) == ["b"]
    assert names(tmp_path) == ["out"]
    (tmp_path / "file").write_text("")
    with pytest.raises(UserError, match="is a file"), atomic.new_folder(tmp_path / "file"):
        pass


def test_folder_in_a_place_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(UserError, match="out: cannot be written"), atomic.new_folder(tmp_path / "file" / "deep" / "out"):
        pass


def test_old_folder_returns_when_the_exchange_is_interrupted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / "a").write_text("1")
    rename = Path.rename

    def interrupted(self: Path, target: Path) -> Path:
        if target == out and "b" in names(self):
            raise KeyboardInterrupt
        return rename(self, target)

    monkeypatch.setattr(Path, "rename", interrupted)
    with pytest.raises(KeyboardInterrupt), atomic.new_folder(out, replace=True) as building:
        (building / "b").write_text("2")
    assert names(out) == ["a"]
    assert names(tmp_path) == ["out"]
