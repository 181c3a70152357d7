"""What the console adds to a scan from the catalogue."""

from dataclasses import replace
from pathlib import Path

from rhizotwin.catalogue.records import Plant, Tag
from rhizotwin.catalogue.store import Catalogue
from rhizotwin.console.plants import Plants
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.solution import Solution
from rhizotwin.scenes.subject import Subject


def test_the_scene_of_a_plant(tmp_path: Path) -> None:
    path = tmp_path / "my.rhizotwin"
    plants = Plants(path)
    tag = Tag(dictionary="6X6_1000", first_id=88, markers=44)
    with Catalogue.open(path) as catalogue:
        catalogue.add_plant(Plant(name="P7", treatment="low N", sown="2026-11-01", solution=Solution(recipe="kliman_2022"), tag=tag))
    given = replace(Scene(), subject=Subject(plant="P7", date="2026-11-26"))
    scene = plants.scene_of(given)
    assert (scene.subject.treatment, scene.subject.day) == ("low N", 25.0)
    assert scene.solution.recipe == "kliman_2022"
    assert (scene.strip.dictionary, scene.strip.first_id) == ("6X6_1000", 88)
    assert plants.scene_of(replace(given, subject=replace(given.subject, day=3.0))).subject.day == 3.0
    other = replace(given, subject=replace(given.subject, plant="P8"))
    assert plants.scene_of(other) == other
    early = replace(given, subject=replace(given.subject, date="2026-10-01"))
    assert plants.scene_of(early).subject.day is None
