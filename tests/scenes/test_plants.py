"""Several plants in a scene: where they hang, and how they are written."""

from rhizotwin.scenes.files import load_scene, save_scene
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
