"""Jobs: their names, their size, and what counts as finished."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from rhizotwin.batches import collect, jobs
from rhizotwin.batches.jobs import Job, Outcome
from rhizotwin.recon.uncertainty import calibration
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.specimens import MeshSpecimen
from tests.rhizotwin.batches.conftest import dataset


@pytest.mark.parametrize("width", ["1" + "0" * 400, "1e308", "NaN", "-5", "{}"])
def test_a_scan_of_impossible_size_is_a_job_like_others(width: str, tmp_path: Path) -> None:
    (tmp_path / "one").mkdir()
    text = f'{{"scene": {{"camera": {{"image_wh": [{width}, 1e308]}}}}, "frames": [1]}}'
    (tmp_path / "one" / "dataset.json").write_text(text, encoding="utf-8")
    (one,) = collect.reconstructions([str(tmp_path)], str(tmp_path / "r"), voxel_mm=None, settings=None, device="cpu")
    assert one.pixels == 20e6


def test_scans_of_one_name_are_told_apart_by_the_folder_above() -> None:
    assert jobs.named(["/x/day1/scan", "/x/day2/scan", "/x/other"]) == ["day1-scan", "day2-scan", "other"]
    assert jobs.named(["s3://bucket/a/scan"]) == ["scan"]
    assert jobs.named(["/x/.day1", "/x/=1+1", "/x/y/.day1", "/"]) == ["x-day1", "1+1", "y-day1", "scan"]


def test_what_is_finished_is_known_by_dataset_settings_code_and_calibration(
    tmp_path: Path, ball_result: Callable[..., Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    def listed(voxel_mm: float | None = None, settings: Path | None = None) -> Job:
        (one,) = collect.reconstructions([str(tmp_path / "scans")], str(tmp_path), voxel_mm=voxel_mm, settings=settings, device="cpu")
        return one

    def finish() -> Job:
        done = listed()
        jobs.note(done, Outcome(name="ball", state="done"))
        assert jobs.is_done(listed())
        return done

    dataset(tmp_path / "scans" / "ball")
    assert not jobs.is_done(listed())
    result = ball_result("ball")
    first = finish()
    (tmp_path / "s.toml").write_text("voxel_mm = 0.3\n", encoding="utf-8")
    assert not jobs.is_done(listed(settings=tmp_path / "s.toml"))
    assert not jobs.is_done(listed(voxel_mm=0.5))
    with monkeypatch.context() as patch:
        patch.setattr(collect.sources, "digest", lambda _: "other")
        assert not jobs.is_done(listed())
    (tmp_path / "calibration.json").write_text("{}", encoding="utf-8")
    with monkeypatch.context() as patch:
        patch.setattr(calibration, "TABLE", tmp_path / "calibration.json")
        assert not jobs.is_done(listed())
    dataset(tmp_path / "scans" / "ball", name="another")
    assert not jobs.is_done(listed())
    finish()
    Path(first.record).write_text("{", encoding="utf-8")
    assert not jobs.is_done(listed())
    finish()
    (result / "result.json").unlink()
    assert not jobs.is_done(listed())


def test_a_scene_is_rendered_again_after_its_mesh_changed(tmp_path: Path) -> None:
    def key() -> str:
        scene = replace(Scene(), specimen=MeshSpecimen(file=str(tmp_path / "root.stl")))
        return collect.renderings({"one": scene}, str(tmp_path), profile="scene", seed=0, device="cpu")[0].key

    missing = key()
    (tmp_path / "root.stl").write_bytes(b"a root")
    first = key()
    assert key() == first != missing
    (tmp_path / "root.stl").write_bytes(b"a thicker root")
    assert key() != first
