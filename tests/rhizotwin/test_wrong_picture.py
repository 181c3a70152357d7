"""A scan of a printed root with one wrong picture among twenty gives the volume of the other nineteen."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

import rhizotwin as rt
from rhizotwin.recon.results.result import Result
from rhizotwin.recon.settings import PictureSettings, Settings

pytestmark = pytest.mark.slow
WRONG = "images/view_003.png"
FIRST_ROW = 80
"""Below the strip of markers, in pictures of 400x300."""


@pytest.fixture(scope="module")
def scan(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("scan") / "dataset"
    rt.simulate(rt.load_scene("printed_8ml", views=20, image_wh=(400, 300)), folder, profile="clean")
    return folder


def reconstruct(scan: Path, **pictures: Any) -> Result:
    return rt.reconstruct(scan, settings=Settings(pictures=PictureSettings(**pictures)))


@pytest.fixture(scope="module")
def without(scan: Path) -> Result:
    return reconstruct(scan, leave_out=(Path(WRONG).name,))


def mirror(picture: np.ndarray) -> np.ndarray:
    return np.concatenate([picture[:FIRST_ROW], picture[FIRST_ROW:, ::-1]])


def fill(brightness: Callable[[np.ndarray], float]) -> Callable[[np.ndarray], np.ndarray]:
    """Return a function that fills the lower half of a picture with one brightness."""

    def spoil(picture: np.ndarray) -> np.ndarray:
        half = len(picture) // 2
        return np.concatenate([picture[:half], np.full_like(picture[half:], brightness(picture))])

    return spoil


SPOILT = {
    "mirrored": mirror,
    "grey": fill(np.median),
    "dim": fill(lambda picture: 0.4 * np.median(picture)),
    "black": fill(lambda _: 0.0),
    "white": fill(np.max),
}


@pytest.mark.parametrize("kind", [*SPOILT, "truncated"])
def test_the_wrong_picture_is_named_and_left_out(kind: str, scan: Path, without: Result) -> None:
    picture = (scan / WRONG).read_bytes()
    listed = (scan / "dataset.json").read_text()
    try:
        if kind == "truncated":
            (scan / WRONG).write_bytes(picture[: len(picture) // 2])
        else:
            cv2.imwrite(str(scan / WRONG), SPOILT[kind](cv2.imread(str(scan / WRONG), cv2.IMREAD_UNCHANGED)))
            frames = json.loads(listed)
            next(frame for frame in frames["frames"] if frame["file"] == WRONG)["sha256"] = ""
            (scan / "dataset.json").write_text(json.dumps(frames))
        found = reconstruct(scan, tolerant=True)
    finally:
        (scan / WRONG).write_bytes(picture)
        (scan / "dataset.json").write_text(listed)
    assert [camera.file for camera in found.cameras if not camera.used] == [WRONG]
    assert any(WRONG in warning for warning in found.warnings)
    assert found.trusted
    assert found.volume_mm3 == pytest.approx(without.volume_mm3, rel=0.02)
