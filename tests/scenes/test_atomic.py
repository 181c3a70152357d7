"""Files and folders appear whole or not at all."""

import errno
import os
from pathlib import Path
from typing import Any, NoReturn

import cv2
import numpy as np
import pytest

from rhizotwin.scenes import atomic
from rhizotwin.scenes.errors import UserError


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def raising(error: BaseException) -> Any:
    def fail(*_: object, **__: object) -> NoReturn:
        raise error

    return fail


FAILURES = {"full": OSError(errno.ENOSPC, "full"), "interrupt": KeyboardInterrupt()}


@pytest.mark.parametrize("error", FAILURES.values(), ids=FAILURES)
def test_full_disk_and_interrupt_keep_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: BaseException) -> None:
    path = tmp_path / "deep" / "a.json"
    atomic.write_json(path, [1])
    monkeypatch.setattr(os, "fsync", raising(error))
    full = isinstance(error, OSError)
    with pytest.raises(UserError if full else KeyboardInterrupt, match=r"a\.json: the disk is full" if full else "^$"):
        atomic.write_json(path, [2])
    assert path.read_text().split() == ["[", "1", "]"]
    assert names(tmp_path / "deep") == ["a.json"]


def test_place_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(UserError, match=r"a\.bin: this path cannot be written"):
        atomic.write_bytes(tmp_path / "file" / "a.bin", b"x")
    (tmp_path / "folder").mkdir()
    with pytest.raises(UserError, match="folder: this path cannot be written"):
        atomic.write_bytes(tmp_path / "folder", b"x")
    assert names(tmp_path) == ["file", "folder"]


@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_colours_survive(tmp_path: Path, kind: type) -> None:
    colour = np.random.default_rng(0).integers(0, np.iinfo(kind).max, (5, 7, 3), dtype=kind, endpoint=True)
    atomic.write_image(tmp_path / "a.png", colour)
    np.testing.assert_array_equal(cv2.imread(str(tmp_path / "a.png"), cv2.IMREAD_UNCHANGED)[..., ::-1], colour)


def test_a_link_is_followed(tmp_path: Path) -> None:
    (tmp_path / "disk").mkdir()
    (tmp_path / "link.txt").symlink_to(tmp_path / "disk" / "there.txt")
    atomic.write_text(tmp_path / "link.txt", "new")
    assert (tmp_path / "disk" / "there.txt").read_text() == "new"
    atomic.write_text(tmp_path / "link.txt", "newer")
    assert (tmp_path / "link.txt").is_symlink()
    assert {path.name: path.read_text() for path in (tmp_path / "disk").iterdir()} == {"there.txt": "newer"}


def test_a_device_is_written_to_and_not_replaced(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    reader = os.open(tmp_path / "pipe", os.O_RDONLY | os.O_NONBLOCK)
    atomic.write_bytes(tmp_path / "pipe", b"through")
    assert os.read(reader, 100) == b"through"
    os.close(reader)
    assert names(tmp_path) == ["pipe"]
    with pytest.raises(UserError, match="null already exists"):
        atomic.write_bytes("/dev/null", b"x", new=True)


def test_a_new_file_replaces_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither one that is there nor one that another process makes at the last moment, with links or without."""
    path = tmp_path / "a.toml"
    atomic.write_text(path, "mine", new=True)
    with pytest.raises(UserError, match=r"a\.toml already exists"):
        atomic.write_text(path, "other", new=True)
    monkeypatch.setattr(os, "link", raising(OSError(errno.EPERM, "no links here")))
    with pytest.raises(UserError, match=r"a\.toml already exists"):
        atomic.write_text(path, "other", new=True)
    atomic.write_text(tmp_path / "b.toml", "b", new=True)
    assert path.read_text() == "mine"
    assert names(tmp_path) == ["a.toml", "b.toml"]


def test_what_a_killed_writer_left_is_removed_by_the_next(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    left = atomic.temporary_path(path)
    left.write_text("half")
    other = atomic.temporary_path(tmp_path / "b.json")
    other.write_text("of another file")
    in_use, descriptor = atomic._open_beside(path)
    atomic.write_json(path, [1])
    assert names(tmp_path) == sorted([other.name, in_use.name, "a.json"])
    os.close(descriptor)
    atomic.write_json(path, [2])
    assert names(tmp_path) == sorted([other.name, "a.json"])
