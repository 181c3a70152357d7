"""Several plants in a scene: where they hang, whose they are, and what is refused."""

import pytest

from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.files import load_scene, save_scene, scene_from_dict, scene_to_dict
from rhizotwin.scenes.plants import Plant
from rhizotwin.scenes.specimens import GrownSpecimen, MeshSpecimen, SphereSpecimen


def test_specimens_stand_where_their_plants_hang() -> None:
    assert Plant(plant="A", at_mm=(5.0, -3.0), specimen=GrownSpecimen()).placed() == GrownSpecimen(origin_mm=(5.0, -3.0, -10.5))
    assert Plant(plant="A", at_mm=(5.0, -3.0), specimen=SphereSpecimen()).placed() == SphereSpecimen(centre_mm=(5.0, -3.0, -55.0))
    moved = Plant(plant="A", at_mm=(5.0, 0.0), specimen=MeshSpecimen(file="a.stl", shift_mm=(1.0, 0.0, -9.0))).placed()
    assert moved == MeshSpecimen(file="a.stl", shift_mm=(6.0, 0.0, -9.0))
    assert Plant(plant="A").placed() is None


def test_the_librarys_scene_is_written_and_read_again(tmp_path) -> None:
    scene = load_scene("two_radishes")
    assert [plant.plant for plant in scene.plants] == ["radish A", "radish B"]
    path = tmp_path / "two.toml"
    save_scene(scene, path)
    assert load_scene(path) == scene
    assert "# Attachment point (x, y) in the net pot's grid" in path.read_text()
    assert path.read_text().count("# Mean diameter at the base of the root") == 6  # of the plants' own specimens, too


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"plants": [{"plant": "A"}, {"plant": "A", "at_mm": [9, 0]}]}, "is already the name of another plant"),
        ({"plants": [{"plant": "plant"}]}, "is reserved for plants without a name"),
        ({"plants": [{"plant": "A", "at_mm": [80, 0]}]}, "inside the canister's wall"),
        ({"plants": [{"plant": "A"}, {"plant": "B", "at_mm": [1, 0]}]}, "must be at least 2 mm from A"),
        ({"plants": [{"plant": "A"}], "specimen": {"kind": "sphere"}}, r"must be omitted if there are \[\[plants\]\]"),
        ({"plants": [{"plant": "A", "at_mm": [60, 0], "specimen": {"kind": "sphere", "diameter_mm": 40}}]}, "must be within the water"),
    ],
)
def test_plants_that_cannot_be_told_apart_are_refused(changes, sentence) -> None:
    plain = scene_to_dict(load_scene("sphere_20mm")) | {"specimen": None} | changes
    with pytest.raises(UserError, match=sentence):
        scene_from_dict(plain, where="scene")
