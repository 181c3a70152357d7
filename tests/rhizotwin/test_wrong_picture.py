"""A scan of a printed root with a mirrored and a truncated picture among twenty gives the volume of the other eighteen."""

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

import rhizotwin as rt
from rhizotwin.recon.results.result import Result
from rhizotwin.recon.settings import PictureSettings, Settings

pytestmark = pytest.mark.nightly
FIRST_ROW = 80
"""Below the strip of markers, in pictures of 400x300."""


def reconstruct(scan: Path, **pictures: Any) -> Result:
    return rt.reconstruct(scan, settings=Settings(pictures=PictureSettings(**pictures)))


def mirror(picture: np.ndarray) -> np.ndarray:
    return np.concatenate([picture[:FIRST_ROW], picture[FIRST_ROW:, ::-1]])


MIRRORED, TRUNCATED = "images/view_003.png", "images/view_013.png"


def test_wrong_pictures_are_named_and_left_out(tmp_path: Path) -> None:
    scan = tmp_path / "dataset"
    rt.simulate(rt.load_scene("printed_8ml", views=20, image_wh=(400, 300)), scan, profile="clean")
    without = reconstruct(scan, leave_out=tuple(Path(file).name for file in (MIRRORED, TRUNCATED)))
    (scan / TRUNCATED).write_bytes((scan / TRUNCATED).read_bytes()[:20_000])
    cv2.imwrite(str(scan / MIRRORED), mirror(cv2.imread(str(scan / MIRRORED), cv2.IMREAD_UNCHANGED)))
    listed = json.loads((scan / "dataset.json").read_text())
    next(frame for frame in listed["frames"] if frame["file"] == MIRRORED)["sha256"] = ""
    (scan / "dataset.json").write_text(json.dumps(listed))
    found = reconstruct(scan, tolerant=True)
    assert [camera.file for camera in found.cameras if not camera.used] == [MIRRORED, TRUNCATED]
    assert all(any(file in warning for warning in found.warnings) for file in (MIRRORED, TRUNCATED))
    assert found.trusted
    assert found.volume_mm3 == pytest.approx(without.volume_mm3, rel=0.02)
