"""Scene and profile files, their subject and descriptions, and the library: round trips, one clear sentence for each mistake."""

import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from rhizotwin.report import rig_figure
from rhizotwin.scenes import files, key_descriptions, subject
from rhizotwin.scenes.dataset import Dataset, Frame, load_dataset, save_dataset
from rhizotwin.scenes.disturbances import Disturbances
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.files import library, load_scene
from rhizotwin.scenes.model import CapturePlan, Ring, Scene, Water
from rhizotwin.scenes.specimens import GrownSpecimen, MeshSpecimen, RootOrder, RsmlSpecimen
from rhizotwin.scenes.subject import Subject
from rhizotwin.scenes.versioned_json import read_versioned_json
from rhizotwin.steps.command_steps import settings_of

MISTAKES: list[tuple[str, str, tuple[str, ...]]] = [
    ("unknown key", "[canister]\n\nwal_mm = 3.0", ("line 3", "[canister] wal_mm", "unknown key", '"wall_mm"')),
    ("above the limit", "# rig\n[canister]\nwall_mm = 900", ("line 3", "[canister] wall_mm = 900", "between 0.2 and 50")),
    ("bool is no number", "[water]\nn_water = true", ("[water] n_water = true", "must be a number, not true or false")),
    ("not a number", "[water]\nn_water = nan", ("[water] n_water = nan", "finite")),
    ("element beyond its limit", "[camera]\nimage_wh = [800, 15]", ("line 2", "image_wh element 2 = 15", "between 16 and 20000")),
    ("none of the choices", "[turntable]\ndirection = 2", ("[turntable] direction = 2", "one of 1, -1")),
    ("second ring", "[[plan.rings]]\n[[plan.rings]]\nviews = 0", ("line 3", "[plan.rings 2] views = 0", "between 1")),
    ("no kind", "[specimen]\ndiameter_mm = 2.0", ("line 1", "[specimen] kind", "missing", '"sphere", "mesh", "rsml", "grown"')),
    ("key of another kind", '[specimen]\nkind = "mesh"\nfile = "a.stl"\nseed = 1', ("line 4", "[specimen] seed", "unknown key")),
    ("not TOML", "[camera\nbits = 12", ("not valid TOML", "line 1")),
]
"""Scene files with something wrong, and what the message must name."""


@pytest.mark.parametrize(("text", "says"), [mistake[1:] for mistake in MISTAKES], ids=[mistake[0] for mistake in MISTAKES])
def test_mistake_is_named(tmp_path: Path, text: str, says: tuple[str, ...]) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(text)
    with pytest.raises(UserError) as caught:
        files.load_scene(path)
    message = str(caught.value).replace(str(tmp_path), "")  # whose name has the case's words in it
    assert "\n" not in message
    assert [words for words in ("mine.toml", *says) if words not in message] == []


def test_files_of_any_editor_are_read_and_1_is_a_float(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text("")
    assert files.load_scene(path) == Scene(name="mine")
    for encoding in ("utf-8", "utf-8-sig", "utf-16", "utf-32"):
        path.write_bytes("[water]\r\nn_water = 1\r\n[canister]\r\nn_wall=1\r\n".encode(encoding))
        scene = files.load_scene(str(path))
        assert type(scene.water.n_water) is float
        assert scene.water.n_water == scene.canister.n_wall == 1.0
        path.write_bytes("[hull]\r\nfinest_mm = 0.2\r\n".encode(encoding))
        assert settings_of(path).hull.finest_mm == 0.2
        path.write_bytes('{"schema_version": 1}'.encode(encoding))
        assert read_versioned_json(path, 1) == {"schema_version": 1}


UNREADABLE = {
    "UTF-16": (b"\xff\xfe\x00", "UTF-8"),
    "UTF-16 without a mark": (b"a\x00=\x001\x00", "UTF-8"),
    "5000 digits": (b"views = " + b"9" * 5000, "is not valid TOML"),
    "deep": (b"a = " + b"[" * 100_000, "is not valid TOML"),
}


@pytest.mark.parametrize(("content", "says"), UNREADABLE.values(), ids=UNREADABLE.keys())
def test_what_cannot_be_read_is_refused_in_a_sentence(tmp_path: Path, content: bytes, says: str) -> None:
    (tmp_path / "mine.toml").write_bytes(content)
    with pytest.raises(UserError, match=rf"mine\.toml.*{says}") as caught:
        files.load_scene(tmp_path / "mine.toml")
    assert "sys." not in str(caught.value)
    assert "recursion" not in str(caught.value)


def test_specimen_file_is_found_beside_the_scene(tmp_path: Path) -> None:
    (tmp_path / "sub").mkdir()
    path = tmp_path / "sub" / "mine.toml"
    path.write_text('[specimen]\nkind = "mesh"\nfile = "../root.stl"')
    assert files.load_scene(path).specimen == MeshSpecimen(file=str((tmp_path / "root.stl").resolve()))
    path.write_text(f'[specimen]\nkind = "rsml"\nunit = "cm"\nfile = {json.dumps(str(tmp_path / "r.rsml"))}')
    assert files.load_scene(path).specimen == RsmlSpecimen(file=str((tmp_path / "r.rsml").resolve()), unit="cm")


def from_json(scene: Scene) -> Scene:
    return files.scene_from_dict(json.loads(json.dumps(files.scene_to_dict(scene))), where="memory")


SCENES = [
    Scene(name='Wurzel "ß"\n\t\\ \x7f\x01', description="日本 # [x]"),
    Scene(specimen=RsmlSpecimen(file="/a/b c.rsml", unit=None, diameter_mm=0.1 + 0.2)),
    Scene(specimen=GrownSpecimen(seed=2**62, orders=(RootOrder(taper=1 / 3), RootOrder(), RootOrder(wobble_deg=1e-7)))),
    Scene(plan=CapturePlan(rings=(Ring(), Ring(height_mm=30.0, tilt_deg=8.0, kind="shoot"))), disturbances=Disturbances(full_well_e=1e5)),
]


@pytest.mark.parametrize("scene", SCENES, ids=range(len(SCENES)))
def test_scenes_survive_toml_and_json(tmp_path: Path, scene: Scene) -> None:
    files.save_scene(scene, tmp_path / "other_name.toml")
    assert files.load_scene(tmp_path / "other_name.toml") == from_json(scene) == scene


@pytest.mark.parametrize(
    ("load", "name", "says"),
    [
        (files.load_scene, "sphere_20m", r'"sphere_20m".*did you mean "sphere_20mm"'),
        (files.load_scene, "{}/nothing.toml", r"nothing\.toml: there is no such file"),
        (files.load_profile, "bensch", r'"bensch".*did you mean "bench".*clean, bench, camera, harsh, real'),
    ],
)
def test_unknown_scene_and_profile_suggest_the_nearest(tmp_path: Path, load: Any, name: str, says: str) -> None:
    with pytest.raises(UserError, match=says):
        load(name.format(tmp_path))


def test_own_profile_file(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text("[disturbances]\nbubbles = 3\n")
    assert files.load_profile(str(path)) == Disturbances(bubbles=3)
    path.write_text("[disturbances]\nbubles = 3\n")
    with pytest.raises(UserError, match=r'line 2: \[disturbances\] bubles: unknown key \(did you mean "bubbles"'):
        files.load_profile(str(path))


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


# Wet root masses in g of radish 1 to 18 (thesis, table A.1), three an age: days 5, 10, ... 30; taken as ml at 1.0 g/ml.
WET_ROOT_G = [
    0.0348, 0.0585, 0.0625, 0.1192, 0.2399, 0.2618, 0.3329, 0.1478, 0.1869,
    0.956, 0.9287, 0.5903, 1.7722, 0.6957, 1.1488, 1.18, 0.3414, 1.7325,
]  # fmt: skip
RADISHES = [f"radish_day{day:02d}{plant}" for day in range(5, 31, 5) for plant in "abc"]

FAMILIES = ["bean", "maize", "wheat", "lettuce", "bulb", "carrot", "radish_swollen"]


def test_the_library_is_complete_and_each_scene_has_its_name() -> None:
    listed = list(library())
    assert {"sphere_20mm", "printed_8ml", *FAMILIES, *RADISHES} < {name for name, _ in listed}
    scenes = [load_scene(name) for name, _ in listed]
    assert [(scene.name, scene.description) for scene in scenes] == listed
    assert all(text.strip() and "\n" not in text for _, text in listed)
    assert {scene.disturbances for scene in scenes} == {Disturbances()}
    with pytest.raises(UserError, match=r"ambiguous; choose radish_day15a, radish_day15b, radish_day15c$"):
        load_scene("radish_day15")


def test_radishes_have_the_volumes_names_and_days_of_the_thesis() -> None:
    scenes = [load_scene(name) for name in RADISHES]
    assert [scene.specimen.volume_ml for scene in scenes] == WET_ROOT_G
    assert len({scene.specimen.seed for scene in scenes}) == len(RADISHES)
    assert [scene.subject.plant for scene in scenes] == [f"radish {number}" for number in range(1, 19)]
    assert [scene.subject.day for scene in scenes] == [5.0 * (1 + k // 3) for k in range(18)]


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


def test_a_scene_prints_what_differs_from_the_default() -> None:
    scene = replace(load_scene("sphere_20mm"), water=Water(n_water=1.34))
    first, *changed = repr(scene).splitlines()
    assert first == f"Scene 'sphere_20mm': {scene.description}"
    assert [line.split(":")[0].strip() for line in changed] == ["water", "specimen"]
    assert changed[0] == "  water: n_water = 1.34"
    assert repr(Scene()) == "Scene 'scene'"
