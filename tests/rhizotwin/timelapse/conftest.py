"""Small experiments on the emulated rig: one strip of a row, four views, sketches."""

from collections.abc import Callable
from pathlib import Path

import pytest

SCENE = """\
name = "small"
[camera]
image_wh = [400, 300]
focal_px = [650.0, 650.0]
principal_px = [199.5, 149.5]
[strip]
columns = 22
rows = 1
marker_mm = 18.0
bottom_mm = 2.0
[[plan.rings]]
views = {views}
height_mm = -20.0
[specimen]
kind = "sphere"
diameter_mm = 10.0
"""


@pytest.fixture
def make_experiment(tmp_path: Path) -> Callable[..., Path]:
    """Return a maker of experiment files."""

    def make(*, plants: int = 2, rounds: int = 2, views: int = 3, schedule: str = "", top: str = "") -> Path:
        (tmp_path / "small.toml").write_text(SCENE.format(views=views))
        text = f'name = "test"\nrig = "twin"\nscene = "small.toml"\n{top}\n'
        text += f'[schedule]\nstart = "2026-12-01T09:00:00+00:00"\nrounds = {rounds}\n{schedule}\n[twin]\nprofile = "clean"\n'
        for number in range(1, plants + 1):
            treatment = "control" if number <= plants // 2 else "low N"
            text += f'[[plants]]\nname = "P{number}"\ncanister = {number}\ntreatment = "{treatment}"\n'
        path = tmp_path / "experiment.toml"
        path.write_text(text)
        return path

    return make
