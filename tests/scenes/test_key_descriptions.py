"""Scene files explain themselves: every key, in the file and on the page, from the same descriptions."""

import tomllib
from pathlib import Path

import pytest

from rhizotwin.report import rig_figure
from rhizotwin.scenes import files, key_descriptions
from rhizotwin.scenes.model import Scene

DOCS = Path(__file__).resolve().parents[2] / "docs"


def test_every_key_has_a_meaning_unit_and_range():
    found = list(key_descriptions.keys())
    assert len({key.path for key in found}) == len(found) > 100
    assert [key.path for key in found if not key.why] == []
    by_path = {key.path: key for key in found}
    wall = by_path["canister.wall_mm"]
    assert (wall.default, wall.unit, wall.limits) == (3.175, "mm", "0.2 to 50")
    assert by_path["specimen.grown.orders.gravitropism_per_mm"].unit == "per mm"
    assert by_path["specimen.grown.orders.elongation_mm_per_day"].unit == "mm per day"
    assert by_path["camera.kind"].limits == '"pinhole" or "telecentric"'
    assert by_path["plan.rings.views"].line().endswith("[1 to 10000]")


@pytest.mark.parametrize("name", ["radish_day05a", "sphere_20mm"])
def test_a_written_scene_explains_every_line_and_reads_back(name: str, tmp_path: Path):
    scene = files.load_scene(name)
    files.save_scene(scene, tmp_path / "copy.toml")
    text = (tmp_path / "copy.toml").read_text(encoding="utf-8")
    assert files.load_scene(tmp_path / "copy.toml") == scene
    tomllib.loads(text)
    before = ""
    for line in text.splitlines():
        if "=" in line and not line.startswith("#"):
            assert before.startswith("#") or line.startswith("kind ="), line
        before = line


def test_the_page_and_the_figure_in_the_documents_are_those_of_the_program():
    assert (DOCS / "scene-keys.md").read_text(encoding="utf-8") == key_descriptions.page()
    assert (DOCS / "pictures" / "rig.svg").read_text(encoding="utf-8") == rig_figure.svg(Scene(name="the default rig")) + "\n"
