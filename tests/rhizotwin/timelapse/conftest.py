"""Small experiments on the emulated rig: one strip of a row, three views, sketches."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest

from rhizotwin.scenes.files import save_scene
from rhizotwin.scenes.model import Camera, CapturePlan, MarkerStrip, Ring, Scene


def small_scene(views: int) -> Scene:
    """Return a scene whose sketches are quick: few small pictures, and a strip of which 26 have different markers."""
    return Scene(
        name="small",
        camera=Camera().resized((400, 300)),
        strip=MarkerStrip(columns=22, rows=1, marker_mm=18.0, bottom_mm=2.0),
        plan=CapturePlan(rings=(Ring(views=views, height_mm=-20.0),)),
    )


def write_experiment(folder: Path, *, plants: int = 2, rounds: int = 2, schedule: str = "") -> Path:
    save_scene(small_scene(3), folder / "small.toml")
    text = 'name = "test"\nrig = "twin"\nscene = "small.toml"\n'
    text += f'[schedule]\nstart = "2026-12-01T09:00:00+00:00"\nrounds = {rounds}\n{schedule}\n[twin]\nprofile = "clean"\n'
    for number in range(1, plants + 1):
        treatment = "control" if number <= plants // 2 else "low N"
        text += f'[[plants]]\nname = "P{number}"\ncanister = {number}\ntreatment = "{treatment}"\n'
    path = folder / "experiment.toml"
    path.write_text(text)
    return path


@pytest.fixture
def make_experiment(tmp_path: Path) -> Callable[..., Path]:
    """Return a maker of experiment files; its keywords are those of `write_experiment`."""
    return partial(write_experiment, tmp_path)
