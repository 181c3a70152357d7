"""The front door: light to import, works in a process where nothing was started, in memory and saved, heard and stopped."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rhizotwin as rt
from tests.conftest import Reconstructed

ROOT = Path(__file__).resolve().parents[2]


def printed(program: str) -> str:
    """Return the last line that a program prints in a process of its own."""
    done = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()[-1]


def test_every_name_is_there() -> None:
    assert set(rt.__all__) <= set(dir(rt))
    for name in rt.__all__:
        assert getattr(rt, name).__name__ == name
    assert rt.__version__[0].isdecimal()
    with pytest.raises(AttributeError, match="no attribute 'recontruct'"):
        rt.recontruct  # noqa: B018


def test_the_device_is_chosen_on_first_use(tmp_path: Path) -> None:
    call = f"rt.simulate(rt.load_scene('sphere_20mm', views=1, image_wh=(16, 16)), {str(tmp_path / 'set')!r})"
    assert printed(f"import rhizotwin as rt; print(len({call}.frames))") == "1"


def test_a_kernel_called_by_itself_starts_the_engine() -> None:
    program = "import numpy as np; from rhizotwin.recon.device import numbers; print(list(numbers(np.arange(3.0)) + 1.0))"
    assert printed(program) == "[1.0, 2.0, 3.0]"


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


def test_traits_have_units_and_are_a_pandas_frame_where_pandas_is(found: Reconstructed) -> None:
    traits = found.result.traits
    rows = {row["name"]: row for row in traits} if isinstance(traits, list) else traits.T.to_dict()
    assert rows["volume_mm3"]["unit"] == "mm3"
    assert rows["volume_mm3"]["value"] == pytest.approx(found.result.volume_mm3)
    assert isinstance(traits, pytest.importorskip("pandas").DataFrame)


def test_a_notebook_shows_picture_and_number(found: Reconstructed) -> None:
    shown = found.result._repr_html_()
    for part in ("data:image/png;base64,", f"<b>{found.result.volume_mm3 / 1000.0:.2f}", "verdict"):
        assert part in shown


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


@pytest.mark.parametrize(
    ("call", "named"),
    [
        (lambda dataset: rt.reconstruct(dataset, voxel_mm=0.0), "0.01"),
        (lambda dataset: rt.reconstruct(dataset, device="tpu"), "tpu"),
        (lambda _: rt.load_scene("sphere_20mm", views=0), "views"),
        (lambda dataset: rt.score("no_such_result", dataset), "no_such_result"),
    ],
    ids=["voxels", "device", "views", "result"],
)
def test_a_mistake_is_one_sentence(call: Any, named: str, made: Path) -> None:
    with pytest.raises(rt.UserError, match=named):
        call(rt.load_dataset(made))
