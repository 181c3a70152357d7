"""Datasets and catalogues in a temporary folder, without a renderer."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rhizotwin.catalogue.store import Catalogue
from rhizotwin.scenes import atomic
from rhizotwin.scenes.dataset import Dataset, Frame, file_sha256, save_dataset
from rhizotwin.scenes.model import Camera, Scene
from rhizotwin.scenes.subject import Subject

SCENE = Scene(name="small", camera=Camera(image_wh=(32, 24), focal_px=(52.0, 52.0), principal_px=(15.5, 11.5)))


@pytest.fixture
def make_dataset(tmp_path: Path) -> Callable[..., Dataset]:
    """Return a maker of datasets with two pictures; its keywords are those of `Subject`."""

    def make(name: str, *, origin: dict[str, Any] | None = None, scene: Scene = SCENE, **whose: Any) -> Dataset:
        folder = tmp_path / "scans" / name
        frames = []
        for number in range(2):
            path = folder / "images" / f"view_{number:03d}.png"
            path.parent.mkdir(parents=True, exist_ok=True)
            atomic.write_image(path, np.full((24, 32), 90 + number, np.uint8))
            frames.append(Frame(file=f"images/{path.name}", sha256=file_sha256(path), table_deg=180.0 * number))
        named = replace(scene, subject=Subject(**whose))
        return save_dataset(Dataset(folder=folder, scene=named, frames=tuple(frames), origin=origin or {}))

    return make


@pytest.fixture
def make_result(ball_result: Callable[..., Path]) -> Callable[..., Path]:
    """Return a maker of results; its other keywords are those of `Subject`."""

    def make(name: str, *, sha256: str = "", focal: float | None = None, changes: dict[str, Any] | None = None, **whose: Any) -> Path:
        rig = {} if focal is None else {"focal_scale_found": focal}
        return ball_result(f"results/{name}", **{"dataset_sha256": sha256, "subject": whose, "rig": rig} | (changes or {}))

    return make


@pytest.fixture
def catalogue(tmp_path: Path) -> Any:
    with Catalogue.create(tmp_path / "study.rhizotwin") as made:
        yield made
