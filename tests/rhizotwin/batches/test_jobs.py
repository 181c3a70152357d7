"""Jobs of a batch: their names, what counts as finished, variations of a scene, and the table and page of the results."""

import os
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any
from urllib.parse import unquote_to_bytes, urljoin, urlsplit

import pytest

from rhizotwin.batches import collect, jobs, overview, places, series
from rhizotwin.batches.jobs import Job, Outcome
from rhizotwin.recon.uncertainty import calibration
from rhizotwin.scenes import files
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.solution import Solution
from rhizotwin.scenes.specimens import MeshSpecimen
from tests.command import Command
from tests.rhizotwin.batches.conftest import dataset, job


def test_scans_of_one_name_are_told_apart_by_the_folder_above() -> None:
    assert jobs.named(["/x/day1/scan", "/x/day2/scan", "/x/other"]) == ["day1-scan", "day2-scan", "other"]
    assert jobs.named(["s3://bucket/a/scan"]) == ["scan"]
    assert jobs.named(["/x/.day1", "/x/=1+1", "/x/y/.day1", "/"]) == ["x-day1", "1+1", "y-day1", "scan"]


def test_finished_means_equal_dataset_settings_code_and_table(tmp_path: Path, ball_result: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    def listed(voxel_mm: float | None = None, settings: Path | None = None) -> Job:
        (one,) = collect.reconstructions([str(tmp_path / "scans")], str(tmp_path), voxel_mm=voxel_mm, settings=settings, device="cpu")
        return one

    dataset(tmp_path / "scans" / "ball")
    assert not jobs.is_done(listed())
    result = ball_result("ball")
    jobs.note(listed(), Outcome(name="ball", state="done"))
    assert jobs.is_done(listed())
    (tmp_path / "s.toml").write_text("voxel_mm = 0.3\n", encoding="utf-8")
    assert not jobs.is_done(listed(settings=tmp_path / "s.toml"))
    assert not jobs.is_done(listed(voxel_mm=0.5))
    (tmp_path / "calibration.json").write_text("{}", encoding="utf-8")
    changes = ((collect.sources, "digest", lambda _: "other"), (calibration, "TABLE", tmp_path / "calibration.json"))
    for change in changes:
        with monkeypatch.context() as patch:
            patch.setattr(*change)
            assert not jobs.is_done(listed())
    (result / "result.json").unlink()
    assert not jobs.is_done(listed())
    ball_result("ball")
    dataset(tmp_path / "scans" / "ball", name="another")
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
    pytest.importorskip("distributed")
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


def test_series_name_plants_days_and_treatments() -> None:
    scene = replace(files.load_scene("radish_day05a"), solution=Solution(recipe="kliman_2022"))
    varied = series.vary(scene, plants=2, days=(3.0, 5.0), treatments=(("control", 1.0, ()), ("low N", 0.85, (("N", 0.5),))))
    assert len(varied) == 8
    one = varied["radish_day05a_low_N_plant2_day03"]
    assert (one.subject.treatment, one.subject.day, one.subject.replicate) == ("low N", 3.0, 2)
    assert len({other.subject.plant for other in varied.values()}) == 4
    assert one.solution.ions_mmol_per_l["NO3"] == pytest.approx(0.5 * scene.solution.ions_mmol_per_l["NO3"])
    with pytest.raises(UserError, match=r"treatment dry of scene .* whose compounds are none"):
        series.vary(files.load_scene("radish_day05a"), treatments=(("dry", 1.0, (("K", 0.5),)),))
    with pytest.raises(UserError, match="have the same name"):
        series.vary(scene, days=(5.01, 5.04))
    with pytest.raises(UserError, match="has no grown plant"):
        series.vary(files.load_scene("sphere_20mm"), plants=2)


def test_the_page_names_plants_and_failures_and_leads_to_reports(ball_result: Callable[..., Path], tmp_path: Path) -> None:
    name = os.fsdecode(b"day:1? #3 50 %25 \xff")
    ball_result(name, subject={"plant": "P<1>", "treatment": "low N"})
    (tmp_path / "two").mkdir()
    overview.write(tmp_path, [job(name, tmp_path)], [(job("two", tmp_path), "the picture <x> is missing")])
    page = (tmp_path / overview.PAGE).read_text(encoding="utf-8")
    assert "P&lt;1&gt;" in page
    assert "<b>two</b>: the picture &lt;x&gt; is missing" in page
    assert "low N" in (tmp_path / overview.TABLE).read_text(encoding="utf-8")
    (link,) = re.findall('href="([^"]*/report.html)"', page)
    found = urlsplit(urljoin((tmp_path / overview.PAGE).as_uri(), link))
    assert (found.scheme, os.fsdecode(unquote_to_bytes(found.path))) == ("file", str(tmp_path / name / "report.html"))


def test_volumes_that_are_not_reliable_are_counted_by_reason() -> None:
    term = {"name": "radii", "less_mm3": 50.0, "more_mm3": 20.0}
    narrow = {"volume_mm3": 100.0, "volume_interval_mm3": [95.0, 105.0], "volume_budget": [term], "views": [{"used": True}] * 12}
    wide = narrow | {"volume_interval_mm3": [50.0, 120.0], "volume_trusted": False}
    dirty = narrow | {"volume_trusted": False, "checks": [{"name": "dirt", "state": "bad"}]}
    good = narrow | {"volume_trusted": True, "checks": [{"name": "dirt", "state": "fair"}]}
    reasons = "2 x dirty canister, 1 x wide interval, 1 x high radii"
    assert overview.summarise([wide, dirty, dirty]) == f"0 of 3 volumes reliable; not reliable: {reasons}"
    assert overview.summarise([good, good]) == "2 of 2 volumes reliable"


def test_a_batch_folder_stands_for_its_results(tmp_path: Path, ball_result: Callable[..., Path], command: Command) -> None:
    ball_result("r/one")
    ball_result(os.fsdecode(b"r/\xff\x1b"))
    jobs.note(job("one", tmp_path / "r"), Outcome(name="one", state="done"))
    overview.write(tmp_path / "r", [job(os.fsdecode(b"\xff\x1b"), tmp_path / "r")], [])
    printed = command.works("traits", tmp_path / "r")
    command.works("traits", tmp_path / "r", "-o", tmp_path / "t.csv")
    assert len((tmp_path / "t.csv").read_text(encoding="utf-8").splitlines()) == 3
    written = command.works("report", tmp_path / "r", "-o", tmp_path / "p.html")
    assert "\x1b" not in printed.out + printed.err + written.out + written.err
