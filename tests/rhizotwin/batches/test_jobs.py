"""Jobs: their names, their size, and what counts as finished."""

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from rhizotwin.batches import collect, jobs, places
from rhizotwin.batches.jobs import Job, Outcome
from rhizotwin.recon.uncertainty import calibration
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.specimens import MeshSpecimen
from tests.command import Command
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


def test_finished_means_equal_dataset_settings_code_and_table(tmp_path: Path, ball_result: Any, monkeypatch: pytest.MonkeyPatch) -> None:
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
    (tmp_path / "calibration.json").write_text("{}", encoding="utf-8")
    changes = ((collect.sources, "digest", lambda _: "other"), (calibration, "TABLE", tmp_path / "calibration.json"))
    for change in changes:
        with monkeypatch.context() as patch:
            patch.setattr(*change)
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


def test_what_cannot_be_run_is_one_sentence(tmp_path: Path, command: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    command.fails("batch", tmp_path, "-o", tmp_path / "r", named=["no dataset was found"])
    pytest.importorskip("dask_jobqueue")
    monkeypatch.setattr("rhizotwin.batches.cluster.WAIT_S", 0.5)
    monkeypatch.setenv("PATH", "")
    scan = dataset(tmp_path / "scans" / "ball")
    words = ("batch", scan, "-o", tmp_path / "r")
    assert "the Dask scheduler could not be reached" in command(*words, "--cluster", "tcp://127.0.0.1:9").err
    command.fails(*words, "--cluster", "slurm", named=["sbatch was not found"])
    (scan / "dataset.json").unlink()
    os.mkfifo(scan / "dataset.json")  # it fails by itself, and holds nobody up
    (one,) = collect.reconstructions([str(scan)], str(tmp_path / "r"), voxel_mm=None, settings=None, device="cpu")
    places.write(one.record, b"[" * 100_000)
    assert not jobs.is_done(one)
    (tmp_path / "r" / "ball").symlink_to(tmp_path)
    command.fails(*words, named=["r/ball: a batch does not write through symbolic links"])
