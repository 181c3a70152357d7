"""Whose roots they are: in scene files, datasets and tables; old files stay readable."""

import json
from pathlib import Path

import pytest

from rhizotwin.scenes import files, subject
from rhizotwin.scenes.dataset import Dataset, Frame, load_dataset, save_dataset
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.subject import Subject

WHOLE = Subject(plant="P7", species="Raphanus sativus", treatment="low N", day=15.0, date="2022-10-16", replicate=2, notes="fell over")


def test_scene_files_and_datasets_keep_it_or_do_without(tmp_path: Path) -> None:
    files.save_scene(Scene(subject=WHOLE), tmp_path / "scene.toml")
    assert files.load_scene(tmp_path / "scene.toml").subject == WHOLE
    save_dataset(Dataset(folder=tmp_path, scene=Scene(subject=WHOLE), frames=(Frame(file="a.png", sha256=""),)))
    assert load_dataset(tmp_path).scene.subject == WHOLE
    path = tmp_path / "dataset.json"
    plain = json.loads(path.read_text(encoding="utf-8"))
    del plain["scene"]["subject"]  # as earlier versions wrote it
    path.write_text(json.dumps(plain), encoding="utf-8")
    assert load_dataset(tmp_path).scene.subject == Subject()


def test_cells_of_a_table_give_it_back() -> None:
    assert subject.from_cells(subject.as_text(WHOLE), "table.csv, line 2") == WHOLE
    assert subject.from_cells({"plant": " P7 ", "volume (mm3)": "3"}, "x") == Subject(plant="P7")


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        ({"date": "16.10.2022"}, "must be a date such as 2022-10-06"),
        ({"treatment": "=HYPERLINK(1)"}, "must not begin with = or @"),
        ({"plant": "a\nb"}, "one line"),
    ],
)
def test_what_cannot_be_is_one_sentence(wrong: dict[str, object], says: str) -> None:
    with pytest.raises(UserError, match=says):
        files.scene_from_dict({"subject": wrong}, where="scene.toml")
