"""Raw pictures: a DNG of known light comes back as that light, and an import of it says that it is light."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from rhizotwin.importer.picture_import import import_pictures
from rhizotwin.importer.raw_pictures import read_raw
from rhizotwin.rig.cameras import raw_files
from rhizotwin.rig.twin.raw_file import encode_dng
from rhizotwin.scenes import transfer
from rhizotwin.scenes.dataset import load_dataset, read_image
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Camera, Scene

WH, HALF = (96, 64), (48, 32)
GAINS = 2.0, 1.5


def light() -> np.ndarray:
    """Return a ramp with a dark bar, as blocks of 2x2 raw pixels see it."""
    ramp = np.tile(np.linspace(0.1, 0.45, HALF[0]), (HALF[1], 1))
    ramp[:, 20:24] = 0.02
    return ramp


def write_dng(path: Path, *, orientation: int = 1) -> None:
    path.write_bytes(encode_dng(light(), exposure_s=0.01, gains=GAINS, orientation=orientation))


def test_a_raw_picture_is_the_light_that_made_it(tmp_path: Path) -> None:
    write_dng(tmp_path / "a.dng")
    found, gains = read_raw(tmp_path / "a.dng", image_wh=HALF)
    assert gains == pytest.approx(GAINS, rel=1e-3)
    assert found / 65535.0 == pytest.approx(light(), abs=4e-4)
    write_dng(tmp_path / "b.dng", orientation=6)
    assert read_raw(tmp_path / "b.dng", image_wh=HALF[::-1])[0] == pytest.approx(np.rot90(found, -1), abs=0)


def test_an_import_stores_light_whatever_the_scene_states(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    for name in ("a.dng", "b.dng"):
        write_dng(tmp_path / "in" / name)
    scene = Scene(camera=replace(Camera().resized(HALF), transfer="srgb"))
    made = import_pictures(tmp_path / "in", scene, tmp_path / "out")
    dataset = load_dataset(made.dataset.folder)
    stored = (dataset.folder / dataset.frames[0].file).read_bytes()
    assert transfer.read_stated_curve(stored) == transfer.LINEAR
    assert read_image(dataset, dataset.frames[0]) / 65535.0 == pytest.approx(light(), abs=4e-4)
    assert any("linear" in note for note in made.notes)


def test_other_raw_pictures_are_refused_in_a_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_dng(tmp_path / "a.dng")
    with pytest.raises(UserError, match="is not an even multiple"):
        read_raw(tmp_path / "a.dng", image_wh=WH)
    (tmp_path / "b.dng").write_bytes((tmp_path / "a.dng").read_bytes()[:400])
    with pytest.raises(UserError, match="the raw picture could not be read"):
        read_raw(tmp_path / "b.dng", image_wh=HALF)
    cv2.imwrite(str(tmp_path / "d.png"), np.zeros(HALF[::-1], np.uint8))
    with pytest.raises(UserError, match="a separate folder"):
        import_pictures(tmp_path, Scene(camera=Camera().resized(HALF)), tmp_path / "out")
    monkeypatch.setattr(raw_files, "find_spec", lambda _: None)
    with pytest.raises(UserError, match="pip install"):
        read_raw(tmp_path / "a.dng", image_wh=HALF)
