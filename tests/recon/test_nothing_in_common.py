"""Silhouettes that have nothing in common: what the pictures failed is said with it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rhizotwin.recon.reconstruct import reconstruct
from rhizotwin.scenes import atomic
from rhizotwin.scenes.dataset import Dataset, Frame
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import CapturePlan, Ring, Scene
from tests.recon.hull import exact_pictures


@pytest.mark.parametrize(("complete", "more"), [(True, ""), (False, "the scan was stopped after 6 pictures")])
def test_what_the_pictures_failed_is_said(tmp_path: Path, complete: bool, more: str) -> None:
    small = Scene()
    scene = replace(small, camera=small.camera.resized((160, 120)), plan=CapturePlan(rings=(Ring(views=6),)))
    listed = []
    for k, view in enumerate(exact_pictures.views_of(scene)):
        mask = np.zeros((120, 160), np.uint8)
        row = 60 if k % 2 else 90
        mask[row : row + 6, 70:90] = 255
        atomic.write_image(tmp_path / f"{k}.png", mask)
        pose = tuple(tuple(float(value) for value in line) for line in view.cam_from_canister)
        listed.append(Frame(file=f"{k}.png", sha256="", cam_from_canister=pose))
    dataset = Dataset(folder=tmp_path, scene=scene, frames=tuple(listed), masks=True, origin={"complete": complete})
    with pytest.raises(UserError, match="no volume in common") as caught:
        reconstruct(dataset)
    assert (more in str(caught.value)) if more else "stopped" not in str(caught.value)
