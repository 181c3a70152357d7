"""Renderings from elsewhere come into the cache if and only if they are what it would render."""

import json
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from benchmarks import datasets
from benchmarks.adopt import adopt
from benchmarks.cases import Pictures
from rhizotwin.scenes.dataset import load_dataset
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.truth import load_truth
from rhizotwin.sim import specimen
from rhizotwin.sim.simulate import simulate

BALL = Pictures(scene="sphere_20mm", rings=2, views=2, image_wh=(32, 24), seed=3)


@pytest.fixture(scope="module", autouse=True)
def coarse_ball() -> Iterator[None]:
    """Render a ball of 320 faces, not of 81920: how round it is makes no difference here."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(specimen, "SPHERE_SUBDIVISIONS", 2)
        yield


@pytest.fixture(scope="module")
def rendered(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("elsewhere") / "ball"
    simulate(BALL.scene_to_render(), folder, profile_name=BALL.profile, seed=BALL.seed)
    return folder


@pytest.fixture
def copy(rendered, tmp_path, monkeypatch) -> Path:
    monkeypatch.setenv("RHIZOTWIN_CACHE", str(tmp_path / "cache"))
    shutil.copytree(rendered, tmp_path / "ball")
    return tmp_path / "ball"


def change(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))


def test_what_fits_is_taken_and_its_truth_kept_up_to_date(copy):
    before = (copy / "dataset.json").read_bytes()
    change(copy / "truth" / "truth.json", '"surface_mm2"', '"of_older_code"')
    assert not datasets.is_ready(BALL)
    adopted = adopt(copy)
    assert adopted == datasets.place(BALL)
    assert datasets.is_ready(BALL)
    assert load_dataset(adopted).frames == load_dataset(copy).frames
    assert "surface_mm2" in load_truth(adopted).traits
    assert (copy / "dataset.json").read_bytes() == before  # the original is left as it was
    assert (copy / "images" / "view_000.png").is_file()

    change(adopted / "truth" / "truth.json", '"surface_mm2"', '"of_older_code"')
    adopted.with_suffix(".truth").write_text("older\n")
    assert not datasets.is_ready(BALL)
    pictures = (adopted / "images" / "view_001.png").stat().st_mtime_ns
    assert adopt(copy) == datasets.make(BALL) == adopted
    assert "surface_mm2" in load_truth(adopted).traits
    assert (adopted / "images" / "view_001.png").stat().st_mtime_ns == pictures
    assert datasets.is_ready(BALL)


def test_another_plan_seed_or_renderer_is_refused(copy):
    manifest = json.loads((copy / "dataset.json").read_text())
    first = manifest["frames"][0]["sha256"]
    for old, new, said in (
        ('"seed": 3', '"seed": 4', "does not fit"),
        ('"height_mm": 10.0', '"height_mm": 11.0', "rig or plan"),
        (first, "0" * 64, "differs when it is rendered"),
        ('"profile": "clean"', '"profile": "bench"', "does not fit"),
    ):
        (copy / "dataset.json").write_text(json.dumps(manifest))
        change(copy / "dataset.json", old, new)
        with pytest.raises(UserError, match=said):
            adopt(copy)
    assert not any(path.is_dir() for path in (datasets.place(BALL).parent).iterdir())
