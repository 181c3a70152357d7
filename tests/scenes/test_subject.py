"""Whose roots they are: in scene files, datasets and tables; old files stay readable."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from rhizotwin.scenes import files, subject
from rhizotwin.scenes.dataset import Dataset, Frame, load_dataset, save_dataset
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.subject import Subject

WHOLE = Subject(plant="P7", species="Raphanus sativus", treatment="low N", day=15.0, date="2022-10-16", replicate=2, notes="fell over")


def test_a_scene_file_keeps_it(tmp_path: Path) -> None:
    files.save_scene(Scene(subject=WHOLE), tmp_path / "scene.toml")
    assert files.load_scene(tmp_path / "scene.toml").subject == WHOLE


def test_a_dataset_keeps_it_and_one_without_is_read(tmp_path: Path) -> None:
    save_dataset(Dataset(folder=tmp_path, scene=Scene(subject=WHOLE), frames=(Frame(file="a.png", sha256=""),)))
    assert load_dataset(tmp_path).scene.subject == WHOLE
    path = tmp_path / "dataset.json"
    plain = json.loads(path.read_text(encoding="utf-8"))
    del plain["scene"]["subject"]  # as earlier versions wrote it
    path.write_text(json.dumps(plain), encoding="utf-8")
    assert load_dataset(tmp_path).scene.subject == Subject()


def test_the_thesis_plants_have_names_and_days() -> None:
    told = [files.load_scene(name).subject for name, _ in files.library() if name.startswith("radish_day")]
    assert sorted(int(one.plant.removeprefix("radish ")) for one in told) == list(range(1, 19))
    assert {one.day for one in told} == {5.0, 10.0, 15.0, 20.0, 25.0, 30.0}


def test_cells_of_a_table_give_it_back() -> None:
    assert subject.of_cells(subject.as_text(WHOLE), "table.csv, line 2") == WHOLE
    assert subject.of_cells({"plant": " P7 ", "volume (mm3)": "3"}, "x") == Subject(plant="P7")


def test_words_for_people() -> None:
    assert str(WHOLE) == "P7 (Raphanus sativus), treatment low N, day 15, 2022-10-16, replicate 2, fell over"
    assert str(Subject()) == ""
    assert str(Subject(species="Lactuca sativa", day=3.5)) == "Lactuca sativa, day 3.5"


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        ({"date": "16.10.2022"}, "must be a date as 2022-10-06"),
        ({"plant": "a\nb"}, "one line"),
        ({"day": -1.0}, "must be between 0 and 36500"),
        ({"plnat": "P7"}, "did you mean"),
    ],
)
def test_what_cannot_be_is_one_sentence(wrong: dict[str, object], says: str) -> None:
    with pytest.raises(UserError, match=says):
        files.scene_from_dict({"subject": wrong}, where="scene.toml")


def test_a_cell_that_is_no_number_is_named() -> None:
    with pytest.raises(UserError, match="line 3: the day 'five' is not a number"):
        subject.of_cells({"day": "five"}, "masses.csv, line 3")


def test_it_is_no_part_of_what_the_pictures_are_made_with() -> None:
    from rhizotwin.sim.simulate import _scene_hash
    from rhizotwin.sim.specimen import build_specimen

    scene = files.load_scene("sphere_20mm")
    solid = build_specimen(scene)
    assert _scene_hash(scene, solid) == _scene_hash(replace(scene, subject=WHOLE), solid)
