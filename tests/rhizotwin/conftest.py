"""Result folders without a reconstruction: a solid ball of 6 mm; scans without a renderer, as `recon` has them; and a browser."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import trimesh

from rhizotwin.scenes import atomic
from tests.recon.conftest import scan
from tests.rhizotwin import plant as plants
from tests.rhizotwin.browser import chromium

__all__ = ["scan"]


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with chromium() as started:
        yield started


@pytest.fixture(scope="session")
def plant(tmp_path_factory: pytest.TempPathFactory) -> plants.Plant:
    """Return a small plant with a name of HTML, which no test may change."""
    return plants.make(tmp_path_factory.mktemp("plant"), name="a *plant* <b>plant</b></script>")


@pytest.fixture
def ball_result(tmp_path: Path) -> Callable[..., Path]:
    """Return a maker of result folders; its keywords change keys of result.json."""

    def make(name: str, **changes: object) -> Path:
        ball = trimesh.creation.icosphere(subdivisions=3, radius=6.0)
        names = {"schema_version": 1, "scene": "ball", "dataset_sha256": "", "timings_s": {}, "settings": {}}
        extents = {"extents_min_mm": [-6.0, -6.0, -6.0], "extents_max_mm": [6.0, 6.0, 6.0], "voxel_mm": 0.25}
        volume = {"volume_mm3": 905.0, "volume_interval_mm3": [850.0, 950.0], "volume_bounds_mm3": [800.0, 1000.0], "hull_mm3": 950.0}
        trust = {"volume_trusted": True, "volume_verdict": "", "untrimmed_mm3": 0.0, "blind_mm3": 0.0}
        lists = dict.fromkeys(("volume_budget", "views", "warnings"), ())
        atomic.write_bytes(tmp_path / name / "shape.ply", bytes(ball.export(file_type="ply")))
        atomic.write_json(tmp_path / name / "result.json", names | extents | volume | trust | lists | changes)
        return tmp_path / name

    return make
