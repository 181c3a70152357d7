"""Scene files explain themselves: every key, in the file and on the page, from the same descriptions."""

from itertools import pairwise
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


@pytest.mark.parametrize("name", ["sphere_20mm", "two_radishes"])
def test_a_written_scene_explains_every_line_and_reads_back(name: str, tmp_path: Path):
    scene = files.load_scene(name)
    files.save_scene(scene, tmp_path / "copy.toml")
    assert files.load_scene(tmp_path / "copy.toml") == scene
    lines = (tmp_path / "copy.toml").read_text(encoding="utf-8").splitlines()
    keys = [(line, before) for before, line in pairwise(lines) if "=" in line and line[0] != "#" and not line.startswith("kind =")]
    assert len(keys) > 50
    assert [line for line, before in keys if before[:1] != "#"] == []
    diameters = sum(line.startswith("# Mean diameter at the base of the root") for line in lines)
    assert diameters == {"sphere_20mm": 0, "two_radishes": 6}[name]  # of the plants' own specimens, too


def test_page_and_figure_in_the_documents_are_of_the_program():
    assert (DOCS / "scene-keys.md").read_text(encoding="utf-8") == key_descriptions.page()
    assert (DOCS / "pictures" / "rig.svg").read_text(encoding="utf-8") == rig_figure.svg(Scene(name="the default rig")) + "\n"
