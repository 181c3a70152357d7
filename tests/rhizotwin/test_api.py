"""The Python interface: light to import, in memory and saved, shown in notebooks, heard and stopped, and wrong types as one sentence."""

import http.client
import json
import re
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from tqdm import tqdm

import rhizotwin as rt
from rhizotwin.scenes.files import profiles
from rhizotwin.scenes.model import Canister
from tests.command import Command
from tests.conftest import Reconstructed
from tests.rhizotwin import plant as plants

ROOT = Path(__file__).resolve().parents[2]
SLOW = ("mitsuba", "drjit", "numba", "trimesh", "skimage", "matplotlib", "manifold3d")


PROGRAMS = {
    "import rhizotwin": ("import rhizotwin", (*SLOW, "numpy", "scipy", "cv2", "tqdm", "cyclopts")),
    "help of every command and the list of scenes": (
        "from rhizotwin.commands import COMMANDS, cli\n"
        "for command in ('', *COMMANDS): cli.main([*command.split(), '--help'])\n"
        "cli.main(['scenes'])",
        (*SLOW, "numpy", "scipy", "cv2"),
    ),
    "the rig on a Raspberry Pi, until the twin renders": (
        "from rhizotwin.commands import scan, rig, camera, twin; from rhizotwin.rig import jog, bench, open\n"
        "from rhizotwin.rig.scanning import scan",
        SLOW,
    ),
    "the viewer, until something is corrected": (
        "from rhizotwin.viewer import app, panels",
        ("mitsuba", "drjit", "trimesh", "scipy", "matplotlib", "skimage"),
    ),
}


def printed(program: str) -> str:
    """Return the last line that a program prints in a process of its own, where nothing was started."""
    done = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()[-1]


@pytest.mark.parametrize(("program", "heavy"), PROGRAMS.values(), ids=PROGRAMS.keys())
def test_nothing_heavy_is_loaded(program: str, heavy: tuple[str, ...]) -> None:
    assert printed(f"import sys\n{program}\nprint([name for name in {heavy} if name in sys.modules])") == "[]"


def test_a_kernel_called_by_itself_starts_the_engine() -> None:
    program = "import numpy as np; from rhizotwin.recon.device import numbers; print(list(numbers(np.arange(3.0)) + 1.0))"
    assert printed(program) == "[1.0, 2.0, 3.0]"


def test_the_interface_is_listed_and_documented() -> None:
    assert set(dir(rt)) == {*rt.__all__, "__version__"}
    assert [getattr(rt, name).__name__ for name in rt.__all__] == list(rt.__all__)
    assert rt.__version__[0].isdecimal()
    with pytest.raises(AttributeError, match="no attribute 'recontruct'"):
        rt.recontruct  # noqa: B018
    texts = [(function.__doc__ or "", name) for function in (rt.load_scene, rt.simulate, rt.scan) for name, _ in profiles()]
    assert [name for text, name in texts if f"``{name}``" not in text] == []


def test_a_result_in_memory_is_the_one_that_is_loaded(found: Reconstructed, made: Path) -> None:
    result, loaded = found.result, rt.load_result(found.folder)
    assert (loaded.volume_mm3, loaded.interval_mm3, loaded.trusted) == (result.volume_mm3, result.interval_mm3, result.trusted)
    assert loaded.interval_mm3[0] <= loaded.volume_mm3 <= loaded.interval_mm3[1]
    assert loaded.roots == result.roots == ()
    assert loaded.measured.surface_mm2 == pytest.approx(result.measured.surface_mm2, rel=1e-6)  # a PLY holds single precision
    assert rt.score(result, rt.load_dataset(made)).volume_error == rt.score(found.folder, made).volume_error


def test_stages_are_kept_for_study(found: Reconstructed) -> None:
    result, stages = found.result, found.folder / "stages"
    kept = {path.stem: json.loads(path.read_text()) for path in stages.glob("*.json")}
    assert set(kept) == {"cameras", "coverage", "hull", "solid"}  # a ball has no thin roots
    poses, coverage, hull = (np.load(stages / f"{name}.npz", allow_pickle=False) for name in ("cameras", "coverage", "hull"))
    assert np.array_equal(poses[kept["cameras"]["all"][3]["cam_from_canister"]["npz"]], result.cameras[3].cam_from_canister)
    assert np.array_equal(coverage["silhouettes/3/coverage"], result.silhouettes[result.cameras[3].file].coverage)
    leaves = kept["hull"]["hull"]["leaves"]
    cubes_mm3 = (hull[leaves["size"]["npz"]] * leaves["grid"]["size_mm"]) ** 3
    assert cubes_mm3 @ hull[leaves["occupancy"]["npz"]] == pytest.approx(result.solid.hull_mm3)
    assert kept["solid"]["volume"]["mm3"] == result.volume_mm3


def test_traits_have_units_and_are_a_frame_of_pandas(found: Reconstructed) -> None:
    traits = found.result.traits
    rows = {row["name"]: row for row in traits} if isinstance(traits, list) else traits.T.to_dict()
    assert (rows["volume_mm3"]["unit"], rows["volume_mm3"]["value"]) == ("mm3", pytest.approx(found.result.volume_mm3))
    assert isinstance(traits, pytest.importorskip("pandas").DataFrame)


def test_representations_are_short_and_safe_in_notebooks(found: Reconstructed, made: Path, plant: plants.Plant) -> None:
    score, result, dataset = rt.score(found.result, made), rt.load_result(plant.result), rt.load_dataset(plant.dataset)
    volume = f"<b>{found.result.volume_mm3 / 1000.0:.2f}"
    values = {"<b>plant": result, "90 % interval": found.result, "true": score, "pictures": dataset}
    assert [named for named, value in values.items() if named not in repr(value)] == []
    assert max(len(repr(value).splitlines()) for value in values.values()) <= 20
    shown = {named: value._repr_html_() for named, value in values.items()}
    assert [text for text in shown.values() if not text.startswith("<") or "<b>plant" in text] == []
    picture = "data:image/png;base64,"
    parts = {"<b>plant": (picture,), "90 % interval": (picture, volume, "verdict"), "true": ("<pre>",), "pictures": (picture,)}
    assert [(named, part) for named, own in parts.items() for part in own if part not in shown[named]] == []


@pytest.mark.parametrize("by", ["order", "diameter"])
def test_a_plot_has_the_colours_of_the_roots(plant: plants.Plant, by: str) -> None:
    drawn = rt.plot(plant.result, by=by)
    assert drawn._repr_png_().startswith(b"\x89PNG")
    picture = np.asarray(drawn.axes[0].images[0].get_array())
    colours = picture[..., :3][picture[..., 3] > 0.9]
    green = ((colours[:, 1] > colours[:, 0]) & (colours[:, 1] > colours[:, 2])).mean()
    assert (green > 0.02) == (by == "diameter")  # main root and laterals of the first order have other colours


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


def test_what_is_in_memory_is_exported_and_pictures_imported(plant: plants.Plant, tmp_path: Path) -> None:
    (written,) = rt.export(rt.load_result(plant.result), tmp_path / "root.stl")
    assert trimesh.load_mesh(written).is_watertight
    dataset = rt.load_dataset(plant.dataset)
    rt.export(plant.result, tmp_path / "cameras.json", dataset=dataset)
    assert len(json.loads((tmp_path / "cameras.json").read_text())["frames"]) == plants.VIEWS
    shown = tmp_path / "saved" / "report.html"
    rt.load_result(plant.result).save(shown.parent)
    assert [shown.is_file(), (shown.parent / "pictures" / "shape.png").is_file()] == [True, True]
    assert rt.write_report([plant.result, shown.parent], tmp_path / "both.html").stat().st_size > 1e4
    assert rt.traits([plant.result, shown.parent], mass_g=(1.0, 2.0))["tissue_density_g_per_ml"].is_monotonic_increasing
    assert len(rt.import_pictures(plant.dataset / "images", tmp_path / "set", scene=dataset.scene).frames) == plants.VIEWS


def test_tables_of_growth_and_biomass_are_frames(tmp_path: Path, command: Command) -> None:
    command.works("biomass", "tables", "-o", tmp_path / "thesis")
    volumes, masses = tmp_path / "thesis" / "kliman_2022_volumes.csv", tmp_path / "thesis" / "kliman_2022_masses.csv"
    model = rt.biomass(volumes, masses=masses, output=tmp_path / "model.json")
    assert model.relations
    predicted = rt.biomass(volumes, model=tmp_path / "model.json", output=tmp_path / "predicted.csv")
    assert len(predicted) > 5
    with pytest.raises(rt.UserError, match="exactly one of masses and model"):
        rt.biomass(volumes, output=tmp_path / "none.csv")
    assert "masses" in rt.growth(masses, tmp_path / "growth")


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


def test_a_class_of_tqdm_shows_one_bar_for_the_whole_work(tmp_path: Path) -> None:
    shown: list[tuple[tqdm, float]] = []

    class Bar(tqdm):
        def refresh(self, *_: Any, **__: Any) -> None:
            shown.append((self, self.n))

    rt.simulate("sphere_20mm", tmp_path / "set", views=2, image_wh=(32, 24), monitor=Bar)
    (bar,) = {one for one, _ in shown}
    numbers = [number for _, number in shown]
    assert numbers == sorted(numbers)
    assert bar.n == pytest.approx(bar.total)
    assert bar.disable, "tqdm's word for closed"


def test_a_callable_hears_of_every_view_and_can_stop(tmp_path: Path) -> None:
    scene = rt.load_scene("sphere_20mm", views=4, image_wh=(64, 48))
    heard: list[tuple[str, int, int]] = []

    def listen(*step: Any) -> None:
        heard.append(step)
        if len(heard) == 2:
            monitor.cancel()

    monitor = rt.Monitor(listen)
    with pytest.raises(rt.Cancelled):
        rt.simulate(scene, tmp_path / "set", profile="clean", monitor=monitor)
    assert heard == [("render", 1, 4), ("render", 2, 4)]
    assert not (tmp_path / "set" / "dataset.json").exists()
    made = rt.simulate(scene, tmp_path / "set", profile="clean")
    assert len(made.frames) == 4, "the same call takes it up"


BALL, NO = "sphere_20mm", "must be width and height, two whole numbers of 16 to 20000, such as (800, 600), not"
MISTAKES: dict[str, tuple[Callable[[], Any], str]] = {
    "size as text": (lambda: rt.simulate(BALL, "x", image_wh="400x300"), f"image_wh {NO} '400x300' (str)"),
    "one size": (lambda: rt.load_scene(BALL, image_wh=400), f"image_wh {NO} '400' (int)"),
    "size too small": (lambda: rt.load_scene(BALL, image_wh=(400, 0)), f"image_wh {NO} '(400, 0)' (tuple)"),
    "views as text": (lambda: rt.load_scene(BALL, views="many"), "views must be a whole number or None, not 'many' (str)"),
    "half a view": (lambda: rt.simulate(BALL, "x", views=4.5), "views must be a whole number or None, not '4.5' (float)"),
    "no views": (lambda: rt.load_scene(BALL, views=0), "views must be 1 to 10000, not 0"),
    "seed below 0": (lambda: rt.simulate(BALL, "x", seed=-1), "seed must be 0 to "),
    "no samples": (lambda: rt.simulate(BALL, "x", samples=0), "samples must be 1 to 65536, not 0"),
    "fidelity of a scan": (lambda: rt.simulate(BALL, "x", fidelity="render"), 'fidelity must be "backlit" or "path", not \'render\''),
    "misspelt fidelity": (lambda: rt.scan("twin", "x", fidelity="skech"), '(did you mean "sketch"?)'),
    "device": (lambda: rt.simulate(BALL, "x", device="gpu"), 'device must be "auto", "cpu" or "cuda", not \'gpu\''),
    "absent profile": (lambda: rt.simulate(BALL, "x", profile="bensh"), 'no disturbance profile "bensh" (did you mean "bench"?)'),
    "number as profile": (lambda: rt.load_scene(BALL, profile=3), "profile must be a text or None, not '3' (int)"),
    "number as scene": (lambda: rt.load_scene(3), "scene must be a path, not '3' (int)"),
    "unknown word": (lambda: rt.simulate(BALL, "x", image_size=1), "simulate has no parameter image_size (did you mean image_wh?)"),
    "no folder": (lambda: rt.simulate(BALL), "simulate needs folder; its parameters are scene, folder, seed"),
    "two folders": (lambda: rt.simulate(BALL, "x", folder="y"), "simulate was given folder twice"),
    "value without a name": (lambda: rt.reconstruct("x", 0.27), "only dataset can be given without a name"),
    "no dataset": (lambda: rt.reconstruct(5.0), "dataset must be a Dataset or a path, not '5.0' (float)"),
    "absent dataset": (lambda: rt.reconstruct("nowhere"), "nowhere: there is no such folder"),
    "settings in a dictionary": (lambda: rt.reconstruct("x", settings={}), "settings must be a Settings or None, not '{}' (dict)"),
    "setting below 0": (lambda: rt.Settings(voxel_mm=-1), "Settings: voxel_mm = -1: must be between 0.01 and 20"),
    "setting changed": (lambda: rt.reconstruct("x", settings=replace(rt.Settings(), voxel_mm=-1)), "voxel_mm = -1: must be"),
    "unknown setting": (lambda: rt.Settings(voxl_mm=1), "Settings has no parameter voxl_mm (did you mean voxel_mm?)"),
    "voxel as text": (lambda: rt.reconstruct("x", voxel_mm="small"), "voxel_mm must be a number or None, not 'small'"),
    "no voxel": (lambda: rt.reconstruct("x", voxel_mm=0.0), "voxel_mm must be 0.01 to 10, not 0.0; check the unit"),
    "mass that is no number": (lambda: rt.reconstruct("x", mass_g=float("nan")), "mass_g must be 1e-06 to 1e+06, not nan"),
    "method without stages": (lambda: rt.reconstruct("x", method="hull", keep_stages="y"), "keep_stages and mass_g are not supported by"),
    "monitor": (lambda: rt.simulate(BALL, "x", monitor=3), "monitor must be a monitor, not '3' (int)"),
    "no result": (lambda: rt.load_result(None), "folder must be a path, not None"),
    "nothing to compare": (lambda: rt.score("x"), "the mesh of the scanned part (truth), its volume (volume_ml)"),
    "volume below 0": (lambda: rt.score("x", volume_ml=-3), "volume_ml must be 1e-06 to 1e+06, not -3; check the unit"),
    "kind of a file": (lambda: rt.score_file("x", "y", kind="Mesh"), '(did you mean "mesh"?)'),
    "colour": (lambda: rt.plot("x", by="length"), 'by must be "order", "diameter", "depth", "uncertainty" or "tip visibility"'),
    "port": (lambda: rt.view("x", port=80000), "port must be 1 to 65535, not 80000"),
    "answer as text": (lambda: rt.view("x", open_browser="no"), "open_browser must be True or False, not 'no' (str)"),
    "misspelt rig": (lambda: rt.scan("twim", "x"), 'no rig file twim (did you mean "twin"?)'),
    "angle": (lambda: rt.scan("twin", "x", table_angle_deg=720), "table_angle_deg must be -360 to 360, not 720; check the unit"),
    "no corrections": (lambda: rt.edit("x", "x/edits.json", "x"), "the corrected result would overwrite the original result x"),
    "masses of others": (lambda: rt.traits("tests", mass_g=[1, 2]), "tests"),
    "nothing to grow": (lambda: rt.growth([], "x"), "results is an empty list"),
    "absent results": (lambda: rt.growth("nowhere", "x"), "results: nowhere does not exist"),
    "no workers": (lambda: rt.batch("x", "y", workers=-1), "workers must be 1 to 10000, not -1"),
    "batch at an address": (lambda: rt.batch("x", "memory://y"), "output must be a folder, not the address memory://y"),
    "misspelt place": (lambda: rt.Placing(place="outo"), 'must be one of "given", "auto" (did you mean "auto"?)'),
    "diameter of a mesh": (lambda: rt.load_scene(BALL, specimen_diameter_mm=1.0), "or remove specimen_diameter_mm"),
    "impossible scene": (lambda: rt.Scene(canister=Canister(outer_radius_mm=7.62)), "Scene: [canister] outer_radius_mm = 7.62: must be at"),
}


@pytest.mark.parametrize(("call", "sentence"), MISTAKES.values(), ids=MISTAKES)
def test_a_mistake_is_one_sentence(call: Callable[[], Any], sentence: str) -> None:
    begun_s = time.process_time()
    with pytest.raises(rt.UserError, match=re.escape(sentence)) as caught:
        call()
    assert time.process_time() - begun_s < 1.0
    assert not re.search(r"--[a-z]|\n", str(caught.value)), "options of commands are no words of Python"
