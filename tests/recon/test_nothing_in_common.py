"""Silhouettes that have nothing in common: what the pictures failed is said with it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rhizotwin.recon.reconstruct import reconstruct
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import CapturePlan, Ring, Scene
from tests.recon.hull import exact_pictures


def test_what_the_pictures_failed_is_said(tmp_path: Path) -> None:
    scene = replace(Scene(), camera=Scene().camera.resized((160, 120)), plan=CapturePlan(rings=(Ring(views=6),)))
    blots = np.zeros((6, 120, 160))
    blots[::2, 90:96, 70:90] = blots[1::2, 60:66, 70:90] = 1.0
    dataset = exact_pictures.masks(tmp_path, scene, dict(enumerate(blots)), complete=False)
    with pytest.raises(UserError, match=r"no volume in common(.|\n)*the scan was stopped after 6 pictures"):
        reconstruct(dataset)
