"""Scene and profile files: round trips, and one clear sentence for each mistake."""

import json
from pathlib import Path
from typing import Any

import pytest

from rhizotwin.command_steps import settings_of
from rhizotwin.scenes import files
from rhizotwin.scenes.disturbances import Disturbances
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import CapturePlan, Ring, Scene
from rhizotwin.scenes.specimens import GrownSpecimen, MeshSpecimen, RootOrder, RsmlSpecimen
from rhizotwin.scenes.versioned_json import read_versioned_json

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
