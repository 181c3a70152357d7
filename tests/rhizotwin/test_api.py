"""The Python interface: short representations, plots, views, progress as one bar, and wrong types as one sentence."""

import http.client
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

import rhizotwin as rt
from rhizotwin.scenes.files import profiles
from tests.command import Command
from tests.conftest import Reconstructed
from tests.rhizotwin import plant as plants


@pytest.fixture(scope="module")
def plant(tmp_path_factory: pytest.TempPathFactory) -> plants.Plant:
    return plants.make(tmp_path_factory.mktemp("plant"), name="a <plant>")


def test_only_the_interface_is_listed() -> None:
    assert set(dir(rt)) == {*rt.__all__, "__version__"}

    assert callable(rt.batch)


def test_representations_are_short_and_have_a_form_for_notebooks(found: Reconstructed, made: Path, plant: plants.Plant) -> None:
    score = rt.score(found.result, made)
    result, dataset = rt.load_result(plant.result), rt.load_dataset(plant.dataset)
    for value, named in ((result, "a <plant>"), (found.result, "90 % interval"), (score, "true"), (dataset, "pictures")):
        assert len(repr(value).splitlines()) <= 20
        assert len(repr(value)) < 3000
        assert named in repr(value)
    for value in (result, score, dataset):
        shown = value._repr_html_()
        assert shown.startswith("<")
        assert "<plant>" not in shown
    assert "data:image/png;base64," in result._repr_html_()
    assert "data:image/png;base64," in dataset._repr_html_()
    assert "<pre>" in score._repr_html_()


@pytest.mark.parametrize("by", ["order", "diameter"])
def test_a_plot_has_the_colours_of_the_roots(plant: plants.Plant, by: str) -> None:
    drawn = rt.plot(plant.result, by=by)
    assert drawn._repr_png_().startswith(b"\x89PNG")
    picture = np.asarray(drawn.axes[0].images[0].get_array())
    colours = picture[..., :3][picture[..., 3] > 0.9]
    green = ((colours[:, 1] > colours[:, 0]) & (colours[:, 1] > colours[:, 2])).mean()
    assert (green > 0.02) == (by == "diameter")  # main root and laterals of the first order have other colours
    with pytest.raises(rt.UserError, match="by must be one of order"):
        rt.plot(plant.result, by="length")


def test_a_view_is_served_and_closed(plant: plants.Plant) -> None:
    with_result = rt.view(rt.load_result(plant.result), plant.dataset, port=8490, open_browser=False)
    host, _, rest = with_result.address.removeprefix("http://").partition(":")
    line = http.client.HTTPConnection(host, int(rest.partition("/")[0]), timeout=20)
    line.request("GET", "/" + rest.partition("/")[2])
    assert line.getresponse().status == 200
    line.close()
    assert with_result.address in with_result._repr_html_()
    with_result._viewer.correct("delete roots", roots=[1])
    with_result._viewer.save()
    assert "save it first with result.save(folder)" in with_result._viewer.message
    assert with_result._viewer.unsaved() == 1
    with_result.close()


def test_files_are_exported_from_memory(plant: plants.Plant, tmp_path: Path) -> None:
    (written,) = rt.export(rt.load_result(plant.result), tmp_path / "root.stl")
    assert trimesh.load_mesh(written).is_watertight
    rt.export(plant.result, tmp_path / "cameras.json", dataset=rt.load_dataset(plant.dataset))
    assert len(json.loads((tmp_path / "cameras.json").read_text())["frames"]) == plants.VIEWS


def test_pictures_are_imported(plant: plants.Plant, tmp_path: Path) -> None:
    scene = rt.load_dataset(plant.dataset).scene
    imported = rt.import_pictures(plant.dataset / "images", tmp_path / "set", scene=scene)
    assert len(imported.frames) == plants.VIEWS


def test_tables_of_growth_and_biomass_are_frames(tmp_path: Path, command: Command) -> None:
    command.works("biomass", "tables", "-o", tmp_path / "thesis")
    volumes, masses = tmp_path / "thesis" / "kliman_2022_volumes.csv", tmp_path / "thesis" / "kliman_2022_masses.csv"
    model = rt.biomass(volumes, masses=masses, output=tmp_path / "model.json")
    assert model.relations
    predicted = rt.biomass(volumes, model=tmp_path / "model.json", output=tmp_path / "predicted.csv")
    assert len(predicted) > 5
    with pytest.raises(rt.UserError, match="exactly one of masses and model"):
        rt.biomass(volumes, output=tmp_path / "none.csv")
    tables = rt.growth(masses, tmp_path / "growth")
    assert "masses" in tables


def test_names_in_tables_are_text(ball_result: Callable[..., Path], tmp_path: Path) -> None:
    folder = ball_result("001", subject={"plant": "07", "treatment": "NA", "day": 5.0})
    table = rt.growth(folder, tmp_path / "growth")["traits"]
    assert table[["plant", "treatment"]].drop_duplicates().to_numpy().tolist() == [["07", "NA"]]
    assert set(table["day"]) == {5.0}
    assert table["low"].dtype == float


def test_a_failed_batch_is_one_sentence(tmp_path: Path) -> None:
    (tmp_path / "scan").mkdir()
    (tmp_path / "scan" / "dataset.json").write_text("{}")
    with pytest.raises(rt.UserError, match="1 of 1 scan failed"):
        rt.batch(tmp_path / "scan", tmp_path / "results", workers=1)


class Bar:
    """A bar of tqdm's kind that remembers what it showed."""

    made: "list[Bar]" = []  # noqa: RUF012 - of all bars

    def __init__(self, total: float, **_: Any) -> None:
        self.total, self.n, self.shown, self.closed = total, 0.0, list[float](), False
        Bar.made.append(self)

    def refresh(self) -> None:  # noqa: D102 - as tqdm has it
        self.shown.append(self.n)

    def set_description_str(self, *_: Any, **__: Any) -> None:  # noqa: D102
        pass

    def close(self) -> None:  # noqa: D102
        self.closed = True


def test_a_class_of_tqdm_shows_one_bar_for_the_whole_work(tmp_path: Path) -> None:
    Bar.made.clear()
    rt.simulate("sphere_20mm", tmp_path / "set", views=2, image_wh=(32, 24), monitor=Bar)
    (bar,) = Bar.made
    assert bar.closed
    assert bar.shown == sorted(bar.shown)
    assert bar.n == pytest.approx(bar.total)


@pytest.mark.parametrize(
    ("call", "sentence"),
    [
        (lambda: rt.load_scene(3), r"scene must be a path, not '3' \(int\)"),
        (lambda: rt.load_result(None), "folder must be a path, not None"),
        (lambda: rt.simulate(None, "x"), "scene must be a Scene or a path, not None"),
        (lambda: rt.reconstruct(5.0), r"dataset must be a Dataset or a path, not '5.0' \(float\)"),
        (lambda: rt.reconstruct("x", voxel_mm="small"), "voxel_mm must be a number or None, not 'small'"),
        (lambda: rt.reconstruct("x", mass_g=0.0), "mass_g must be .* g, not 0"),
        (lambda: rt.reconstruct("x", settings={}), "settings must be a Settings or None"),
        (lambda: rt.score([], "x"), "result must be a Result or a path"),
        (lambda: rt.simulate("sphere_20mm", "x", monitor=3), "monitor must be"),
        (lambda: rt.view(7), "result must be a Result or a path"),
        (lambda: rt.export(7, "x.stl"), "result must be a Result or a path"),
        (lambda: rt.growth([], "x"), "results is an empty list"),
        (lambda: rt.batch([3], "x"), "datasets must be a path"),
        (lambda: rt.batch("x", "y", workers=-1), "workers must be at least 1, not -1"),
        (lambda: rt.batch("x", "y", workers="2"), "workers must be a whole number or None"),
        (lambda: rt.batch("x", "y", voxel_mm=-1.0), "the call of batch: .*voxel_mm"),
        (lambda: rt.batch("x", "memory://y"), "output must be a folder, not the address memory://y"),
    ],
)
def test_a_wrong_type_is_one_sentence(call: Any, sentence: str) -> None:
    with pytest.raises(rt.UserError, match=sentence):
        call()


def test_texts_name_all_profiles() -> None:
    for function in (rt.load_scene, rt.simulate, rt.scan):
        for name, _ in profiles():
            assert f"``{name}``" in (function.__doc__ or "")
