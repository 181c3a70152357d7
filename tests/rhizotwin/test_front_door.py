"""The front door: light to import, works in a process where nothing was started, in memory and saved, heard and stopped."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

import rhizotwin as rt

ROOT = Path(__file__).resolve().parents[2]
HEAVY = ("numpy", "scipy", "mitsuba", "drjit", "trimesh", "skimage", "matplotlib", "manifold3d", "cv2", "tqdm", "cyclopts")


def printed(program: str) -> str:
    """Return the last line that a program prints in a process of its own."""
    done = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()[-1]


@pytest.fixture(scope="module")
def ball(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a ball's mesh beside the axis, so that its silhouette goes about in the pictures."""
    solid = trimesh.creation.icosphere(subdivisions=3, radius=8.0)
    solid.apply_translation((18.0, 0.0, -60.0))
    file = tmp_path_factory.mktemp("ball") / "ball.stl"
    solid.export(file)
    return file


@pytest.fixture(scope="module")
def dataset(ball: Path, tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Simulate a small dataset."""
    scene = rt.load_scene("sphere_20mm", specimen=ball, views=10, image_wh=(320, 240))
    return rt.simulate(scene, tmp_path_factory.mktemp("set") / "dataset", profile="clean")


@pytest.fixture(scope="module")
def stages(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("stages")


@pytest.fixture(scope="module")
def result(dataset: Any, stages: Path) -> Any:
    """Reconstruct it in memory."""
    return rt.reconstruct(dataset, voxel_mm=2.0, keep_stages=stages)


def test_importing_loads_nothing() -> None:
    assert printed(f"import sys, rhizotwin; print([name for name in {HEAVY} if name in sys.modules])") == "[]"


def test_every_name_is_there() -> None:
    assert set(rt.__all__) <= set(dir(rt))
    for name in rt.__all__:
        assert getattr(rt, name).__name__ == name
    assert rt.__version__[0].isdecimal()
    with pytest.raises(AttributeError, match="no attribute 'recontruct'"):
        rt.recontruct  # noqa: B018


def test_the_device_is_chosen_on_first_use(dataset: Any) -> None:
    program = f"import rhizotwin as rt; print(rt.reconstruct({str(dataset.folder)!r}, voxel_mm=2.0).volume_mm3 > 0.0)"
    assert printed(program) == "True"


def test_a_kernel_called_by_itself_starts_the_engine() -> None:
    program = "import numpy as np; from rhizotwin.recon.device import numbers; print(list(numbers(np.arange(3.0)) + 1.0))"
    assert printed(program) == "[1.0, 2.0, 3.0]"


def test_a_result_in_memory_is_the_one_that_is_loaded(result: Any, dataset: Any, tmp_path: Path) -> None:
    result.save(tmp_path / "result")
    loaded = rt.load_result(tmp_path / "result")
    assert (loaded.volume_mm3, loaded.interval_mm3, loaded.trusted) == (result.volume_mm3, result.interval_mm3, result.trusted)
    assert loaded.interval_mm3[0] <= loaded.volume_mm3 <= loaded.interval_mm3[1]
    assert loaded.roots == result.roots == ()
    assert loaded.measured.surface_mm2 == pytest.approx(result.measured.surface_mm2, rel=1e-6)  # a PLY holds single precision
    in_memory, of_folder = rt.score(result, dataset), rt.score(tmp_path / "result", dataset.folder)
    assert in_memory.volume_error == of_folder.volume_error
    assert abs(in_memory.volume_error) < 0.1


def test_stages_are_kept_for_study(result: Any, stages: Path) -> None:
    kept = {path.stem: json.loads(path.read_text()) for path in stages.glob("*.json")}
    assert set(kept) == {"cameras", "coverage", "hull", "solid"}  # a ball has no thin roots
    poses, coverage, hull = (np.load(stages / f"{name}.npz", allow_pickle=False) for name in ("cameras", "coverage", "hull"))
    assert np.array_equal(poses[kept["cameras"]["all"][3]["cam_from_canister"]["npz"]], result.cameras[3].cam_from_canister)
    assert np.array_equal(coverage["silhouettes/3/coverage"], result.silhouettes[result.cameras[3].file].coverage)
    leaves = kept["hull"]["carved"]["hull"]["leaves"]
    cubes_mm3 = (hull[leaves["size"]["npz"]] * leaves["grid"]["size_mm"]) ** 3
    assert cubes_mm3 @ hull[leaves["occupancy"]["npz"]] == pytest.approx(result.solid.hull_mm3)
    assert kept["solid"]["volume"]["mm3"] == result.volume_mm3


def test_traits_have_units(result: Any) -> None:
    rows = {row["name"]: row for row in result.traits} if isinstance(result.traits, list) else result.traits.T.to_dict()
    assert rows["volume"]["unit"] == "mm3"
    assert rows["volume"]["value"] == pytest.approx(result.volume_mm3)


def test_traits_are_a_pandas_frame_where_pandas_is(result: Any) -> None:
    pd = pytest.importorskip("pandas")
    assert isinstance(result.traits, pd.DataFrame)
    assert result.traits.loc["volume", "value"] == pytest.approx(result.volume_mm3)


def test_a_notebook_shows_picture_and_number(result: Any) -> None:
    shown = result._repr_html_()
    assert "data:image/png;base64," in shown
    assert f"{result.volume_mm3:.1f} mm" in shown
    assert "trusted" in shown


def test_a_callable_hears_of_every_view_and_can_stop(ball: Path, tmp_path: Path) -> None:
    scene = rt.load_scene("sphere_20mm", specimen=ball, views=4, image_wh=(64, 48))
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


MISTAKES = {
    "voxels": (lambda dataset: rt.reconstruct(dataset, voxel_mm=0.0), "0.01"),
    "device": (lambda dataset: rt.reconstruct(dataset, device="tpu"), "tpu"),
    "folder": (lambda _: rt.reconstruct("no_such_dataset"), "no_such_dataset"),
    "scene": (lambda _: rt.load_scene("no_such_scene"), "no_such_scene"),
    "views": (lambda _: rt.load_scene("sphere_20mm", views=0), "views"),
    "profile": (lambda _: rt.simulate("sphere_20mm", "d", profile="foggy"), "foggy"),
    "result": (lambda dataset: rt.score("no_such_result", dataset), "no_such_result"),
}


@pytest.mark.parametrize(("call", "named"), MISTAKES.values(), ids=MISTAKES.keys())
def test_a_mistake_is_one_sentence(call: Any, named: str, dataset: Any) -> None:
    with pytest.raises(rt.UserError, match=named):
        call(dataset)
