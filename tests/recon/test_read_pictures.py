"""Which pictures of a dataset are read, and what becomes of those that are not."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rhizotwin.recon.read_pictures import read_pictures
from rhizotwin.recon.reconstruct import reconstruct
from rhizotwin.recon.settings import PictureSettings
from rhizotwin.scenes.atomic import write_image
from rhizotwin.scenes.bands import Band
from rhizotwin.scenes.dataset import Dataset, Frame, load_dataset
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Camera, Scene
from rhizotwin.scenes.monitor import Monitor
from tests.recon.hull import exact_pictures


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
    with pytest.raises(UserError, match=r"--leave-out view_9\.png: .* lists no picture with this name"):
        read(made, leave_out=("view_9.png",))
    with pytest.raises(UserError, match="all root pictures are excluded"):
        read(made, leave_out=tuple(f"view_00{k}.png" for k in range(6)))


def test_scenes_with_other_vessels_and_lights_are_refused(scan: Callable) -> None:
    dataset = load_dataset(scan().dataset)
    lit = replace(dataset.scene, lights=replace(dataset.scene.lights, side_level=0.3))
    with pytest.raises(UserError, match="lit from the side"):
        reconstruct(replace(dataset, scene=lit))


def test_empty_hulls_are_told_with_what_the_pictures_failed(tmp_path: Path) -> None:
    scene = exact_pictures.ring_of(6, (160, 120))
    blots = np.zeros((6, 120, 160))
    blots[::2, 90:96, 70:90] = blots[1::2, 60:66, 70:90] = 1.0
    dataset = exact_pictures.masks(tmp_path, scene, dict(enumerate(blots)), complete=False)
    with pytest.raises(UserError, match=r"no volume in common(.|\n)*the scan was stopped after 6 pictures"):
        reconstruct(dataset)


BANDS = (Band(name="faint"), Band(name="clear"), Band(name="noisy"), Band(name="dark", panel_level=0.0))
DEPTH = {"faint": 0.03, "clear": 0.4, "noisy": 0.4, "dark": 0.7}
NOISE = {"faint": 0.005, "clear": 0.005, "noisy": 0.05, "dark": 0.001}


def dataset_in(folder: Path, *bands: str) -> Dataset:
    """Draw upright lines two pixels wide before an even panel, three views in each band."""
    scene = Scene(camera=replace(Camera().resized((200, 150)), bands=BANDS))
    frames, rng = [], np.random.default_rng(0)
    for view in range(3):
        for band in bands:
            light = np.full((150, 200), 0.75)
            for x in range(40, 160, 12):
                light[60:, x : x + 2] *= 1.0 - DEPTH[band]
            light += rng.normal(0.0, NOISE[band], light.shape)
            write_image(folder / f"{view}_{band}.png", (np.clip(light, 0.0, 1.0) * 65535).astype(np.uint16))
            frames.append(Frame(file=f"{view}_{band}.png", sha256="", band=band, view=view))
    return Dataset(folder=folder, scene=scene, frames=tuple(frames))


def test_the_band_with_the_largest_ratio_is_read(tmp_path: Path) -> None:
    dataset = dataset_in(tmp_path, "faint", "noisy", "clear", "dark")
    pictures = read_pictures(dataset, monitor=Monitor())
    assert [frame.file for frame in pictures.frames] == ["0_clear.png", "1_clear.png", "2_clear.png"]
    assert list(pictures.bands) == ["clear", "noisy", "faint"], "without its panel a band shows no outlines"
    assert pictures.bands["clear"] / pictures.bands["noisy"] == pytest.approx(10.0, rel=0.15), "as the noise"
    chosen = read_pictures(dataset, settings=PictureSettings(band="faint"), monitor=Monitor())
    assert {frame.band for frame in chosen.frames} == {"faint"}
    with pytest.raises(UserError, match="no root pictures in the band blue"):
        read_pictures(dataset, settings=PictureSettings(band="blue"), monitor=Monitor())


def test_a_band_that_lacks_a_view_is_not_chosen(tmp_path: Path) -> None:
    dataset = dataset_in(tmp_path, "faint", "clear")
    fewer = replace(dataset, frames=dataset.frames[:-1])
    assert list(read_pictures(fewer, monitor=Monitor()).bands) == ["faint"]
    with pytest.raises(UserError, match="no band in which the panel and the front light are on has a picture of every root view"):
        read_pictures(replace(dataset, frames=(dataset.frames[0], dataset.frames[3])), monitor=Monitor())
