"""Many scans: what is found and named, what counts as finished, memory, processes that die, other file systems, the page."""

import json
import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from multiprocessing import Pipe
from pathlib import Path
from typing import Any
from urllib.parse import unquote_to_bytes, urljoin, urlsplit

import pytest

from rhizotwin.batches import collect, jobs, local, overview, places, series, work
from rhizotwin.batches.jobs import Job, Outcome
from rhizotwin.batches.run import LOCK, run
from rhizotwin.recon.uncertainty import calibration
from rhizotwin.scenes import atomic, files
from rhizotwin.scenes.dataset import Dataset, Frame, save_dataset
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.lock import lock_file
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.solution import Solution
from rhizotwin.scenes.specimens import MeshSpecimen
from tests.command import Command


def dataset(folder: Path, *, name: str = "scene") -> Path:
    """Write a dataset whose only picture is missing: its job fails at once."""
    save_dataset(Dataset(folder=folder, scene=Scene(name=name), frames=(Frame(file="images/a.png", sha256=""),)))
    return folder


def job(name: str, folder: Path, **changes: object) -> Job:
    options = {"voxel_mm": None, "settings": None, "device": "cpu"}
    plain = Job(name=name, kind="reconstruct", source=str(folder / "none"), output=str(folder / name), key="k", pixels=1e6, options=options)
    return replace(plain, **changes)


def test_datasets_are_found_in_folders_and_patterns_each_once(tmp_path: Path) -> None:
    for place in ("a/one", "a/deep/two", "b/three"):
        dataset(tmp_path / place)
    assert [Path(found).name for found in places.find_datasets(str(tmp_path / "a"))] == ["two", "one"]
    assert places.find_datasets(str(tmp_path / "b" / "three")) == [str(tmp_path / "b" / "three")]
    given = [str(tmp_path / "a"), str(tmp_path / "*"), str(tmp_path / "a" / "one")]
    made = collect.reconstructions(given, str(tmp_path / "results"), voxel_mm=None, settings=None, device="cpu")
    assert sorted(one.name for one in made) == ["one", "three", "two"]


def test_hidden_folders_are_searched_only_if_they_are_given(tmp_path: Path) -> None:
    for place in (".lab/one", ".lab/.trash/two", ".lab/.three"):
        dataset(tmp_path / place)
    for given in (".lab", ".lab/one", ".lab/*", ".lab/**"):
        assert places.find_datasets(str(tmp_path / given)) == [str(tmp_path / ".lab" / "one")]
    with pytest.raises(UserError, match="no dataset was found"):
        places.find_datasets(str(tmp_path))


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


def test_what_cannot_be_run_is_one_sentence(tmp_path: Path, command: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    command.fails("batch", tmp_path, "-o", tmp_path / "r", named=["no dataset was found"])
    pytest.importorskip("distributed")
    monkeypatch.setattr("rhizotwin.batches.cluster.WAIT_S", 0.5)
    words = ("batch", dataset(tmp_path / "scans" / "a").parent, "-o", tmp_path / "r", "--cluster", "tcp://127.0.0.1:9")
    assert "the Dask scheduler could not be reached" in command(*words).err


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


def test_only_so_many_run_at_once_as_memory_holds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    given: list[str] = []

    class Line:
        def send(self, plain: dict[str, object]) -> None:
            given.append(str(plain["name"]))

    monkeypatch.setattr(local, "_hire", lambda _: local._Worker(None, Line()))
    waiting = [job("large", tmp_path, pixels=40e6), job("huge", tmp_path, pixels=90e6), job("small", tmp_path, pixels=2e6)]
    crew: list[local._Worker] = []
    local._hand_out(waiting, crew, 8, waiting[0].memory_mib + waiting[2].memory_mib)
    assert given == ["large", "small"]
    crew[0].job = crew[1].job = None
    local._hand_out(waiting, crew, 8, 100.0)  # one always runs, however large
    assert given == ["large", "small", "huge"]


def test_jobs_are_stopped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    killed: list[str] = []

    class Process:
        def kill(self) -> None:
            killed.append("killed")

        def join(self) -> None:
            killed.append("joined")

    line, _other = Pipe()
    monkeypatch.setattr(local, "_hire", lambda _: local._Worker(Process(), line))
    monkeypatch.setattr(local, "LOOK_S", 0.01)
    stops = iter([False, False, True])
    assert list(local.run([job("a", tmp_path)], workers=1, stop=lambda: next(stops))) == []
    assert killed == ["killed", "joined"]


def test_a_damaged_scan_fails_with_its_sentence_and_a_killed_process_is_replaced(tmp_path: Path) -> None:
    bad = dataset(tmp_path / "bad")
    given = [job(f"job{k}", tmp_path, source=str(bad)) for k in range(3)]
    outcomes: dict[str, Outcome] = {}
    before = _children()

    def kill() -> None:
        """Kill the first process while it loads."""
        for _ in range(200):
            new = [child for child in _children() - before if "spawn_main" in _command(child)]
            if new:
                time.sleep(0.5)
                os.kill(new[0], signal.SIGKILL)
                return
            time.sleep(0.05)

    killer = threading.Thread(target=kill)
    killer.start()
    for one, outcome in local.run(given, workers=1):
        assert one.name not in outcomes  # nothing twice
        outcomes[one.name] = outcome
    killer.join()
    assert {outcome.state for outcome in outcomes.values()} == {"failed"}
    assert all("the picture is missing" in outcome.sentence for outcome in outcomes.values())
    record = json.loads((tmp_path / jobs.RECORDS / "job1.json").read_text(encoding="utf-8"))
    assert (record["state"], record["key"]) == ("failed", "k")


@pytest.mark.parametrize(("code", "named"), [(-9, "signal SIGKILL"), (-40, "signal 40"), (3, "exit code 3")])
def test_a_process_that_died_names_its_signal(code: int, named: str, tmp_path: Path) -> None:
    class Dead:
        exitcode = code

        def join(self) -> None:
            pass

    ours, theirs = Pipe()
    theirs.close()
    worker = local._Worker(Dead(), ours, job("a", tmp_path))
    assert f"died ({named})" in local._hear(worker, [worker]).sentence


def _children() -> set[int]:
    listed = subprocess.run(["ps", "-o", "pid=", "--ppid", str(os.getpid())], capture_output=True, text=True, check=False)
    return {int(word) for word in listed.stdout.split()}


def _command(pid: int) -> str:
    try:
        return Path(f"/proc/{pid}/cmdline").read_text(encoding="utf-8")
    except OSError:
        return ""


def test_a_full_disk_is_not_the_scans_fault(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(_: Job) -> None:
        raise OSError(28, "No space left on device", "result")

    monkeypatch.setattr(work, "_reconstruct", full)
    outcome = Outcome(**work.work(job("a", tmp_path).plain()))
    assert (outcome.state, outcome.sentence) == ("again", "result: the disk is full; free some space and run the same command again")


def test_two_batches_do_not_work_in_one_folder(tmp_path: Path) -> None:
    with lock_file(tmp_path / LOCK, what="it"), pytest.raises(UserError, match="is using it"):
        run([job("a", tmp_path)], str(tmp_path))


@pytest.fixture
def elsewhere() -> Iterator[str]:
    """Return an address of a file system in memory."""
    fsspec = pytest.importorskip("fsspec")
    yield "memory://batch"
    fsspec.filesystem("memory").store.clear()


def test_addresses_are_found_fetched_and_put(elsewhere: str, tmp_path: Path) -> None:
    import fsspec

    here = dataset(tmp_path / "here")
    (here / "images").mkdir()
    (here / "images" / "a.png").write_bytes(b"picture")
    places.put(here, f"{elsewhere}/scans/one", last="dataset.json")
    assert [places.name_of(found) for found in places.find_datasets(f"{elsewhere}/scans")] == ["one"]
    places.fetch(f"{elsewhere}/scans/one", tmp_path / "back")
    assert (tmp_path / "back" / "images" / "a.png").read_bytes() == b"picture"
    places.write(f"{elsewhere}/jobs/a.json", b"{}")
    assert places.read(f"{elsewhere}/jobs/a.json") == b"{}"
    assert places.read(f"{elsewhere}/jobs/b.json") is None
    assert fsspec.filesystem("memory").exists("/batch/scans/one/dataset.json")
    with pytest.raises(UserError, match="could not be opened"):
        places.find_datasets("nowhere://x")


def test_a_scan_at_an_address_that_cannot_be_read_fails_alone(elsewhere: str, monkeypatch: pytest.MonkeyPatch) -> None:
    import fsspec

    def refuse(self: object, path: str) -> bytes:
        if "secret" in path:
            raise PermissionError(path)
        return read(self, path)

    places.write(f"{elsewhere}/scans/one/dataset.json", b"{}")
    places.write(f"{elsewhere}/scans/secret/dataset.json", b"{}")
    read = fsspec.get_filesystem_class("memory").cat_file
    monkeypatch.setattr(fsspec.get_filesystem_class("memory"), "cat_file", refuse)
    made = collect.reconstructions([f"{elsewhere}/scans"], f"{elsewhere}/r", voxel_mm=None, settings=None, device="cpu")
    assert [one.name for one in made] == ["one", "secret"]


def test_an_earlier_result_at_an_address_leaves_no_file_behind(elsewhere: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made = ["result.json", "roots.rsml", "silhouettes/a.png"]

    def reconstruct(_: Path, output: Path, **__: object) -> None:
        for name in made:
            atomic.write_bytes(output / name, b"new")

    monkeypatch.setattr("rhizotwin.command_steps.reconstruct_whole", reconstruct)
    remote = replace(job("one", tmp_path), output=f"{elsewhere}/r/one")
    places.write(f"{elsewhere}/r/one/notes.txt", b"mine")
    assert work.work(remote.plain())["state"] == "done"
    made[1:] = ["silhouettes/b.png"]
    assert work.work(remote.plain())["state"] == "done"
    places.fetch(f"{elsewhere}/r/one", tmp_path / "back")
    assert sorted(str(path.relative_to(tmp_path / "back")) for path in (tmp_path / "back").rglob("*.*")) == [
        "notes.txt",
        "result.json",
        "silhouettes/b.png",
    ]


def test_the_table_and_the_page_tell_whose_they_are_and_what_failed(ball_result: Callable[..., Path], tmp_path: Path) -> None:
    ball_result("one", subject={"plant": "P<1>", "treatment": "low N"})
    (tmp_path / "two").mkdir()
    overview.write(tmp_path, [job("one", tmp_path)], [(job("two", tmp_path), "the picture <x> is missing")])
    page = (tmp_path / overview.PAGE).read_text(encoding="utf-8")
    assert "P&lt;1&gt;" in page
    assert "<b>two</b>: the picture &lt;x&gt; is missing" in page
    assert "low N" in (tmp_path / overview.TABLE).read_text(encoding="utf-8")


@pytest.mark.parametrize("name", ["plant #3", "50 %25", "day:1?", os.fsdecode(b"\xff")])
def test_the_page_leads_to_reports_of_all_names(name: str, ball_result: Callable[..., Path], tmp_path: Path) -> None:
    ball_result(name)
    overview.write(tmp_path, [job(name, tmp_path)], [])
    (link,) = re.findall('href="([^"]*/report.html)"', (tmp_path / overview.PAGE).read_text(encoding="utf-8"))
    found = urlsplit(urljoin((tmp_path / overview.PAGE).as_uri(), link))
    assert (found.scheme, os.fsdecode(unquote_to_bytes(found.path))) == ("file", str(tmp_path / name / "report.html"))


def test_volumes_that_are_not_usable_are_counted_by_reason() -> None:
    term = {"name": "radii", "less_mm3": 50.0, "more_mm3": 20.0}
    narrow = {"volume_mm3": 100.0, "volume_interval_mm3": [95.0, 105.0], "volume_budget": [term], "views": [{"used": True}] * 12}
    wide = narrow | {"volume_interval_mm3": [50.0, 120.0], "volume_trusted": False}
    dirty = narrow | {"volume_trusted": False, "checks": [{"name": "dirt", "state": "bad"}]}
    good = narrow | {"volume_trusted": True, "checks": [{"name": "dirt", "state": "fair"}]}
    reasons = "2 x dirty canister, 1 x wide interval, 1 x high radii"
    assert overview.summarise([wide, dirty, dirty]) == f"0 of 3 volumes usable; not usable: {reasons}"
    assert overview.summarise([good, good]) == "2 of 2 volumes usable"
    assert overview.summarise([dirty | {"checks": []}]) == "0 of 1 volumes usable; not usable: 1 x other"


@pytest.mark.slow
def test_the_overview_fits_a_narrow_screen(browser: Any, ball_result: Callable[..., Path], tmp_path: Path) -> None:
    ball_result("one", subject={"plant": "P1", "treatment": "low N"})
    overview.write(tmp_path, [job("one", tmp_path)], [])
    shown = browser.new_page(viewport={"width": 400, "height": 700})
    shown.goto((tmp_path / overview.PAGE).as_uri())
    widths = "[document.documentElement.scrollWidth, document.querySelector('.wide').scrollWidth]"
    assert max(shown.evaluate(widths)) <= 400
    visible = [cell.inner_text() for cell in shown.locator("th").all() if cell.is_visible()]
    assert visible == ["verdict", "volume (90 % interval)", "", "scan"]
    shown.close()


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
    same = series.vary(scene, days=(5.0,))["radish_day05a_day05"]
    assert same.specimen.volume_ml == pytest.approx(scene.specimen.volume_ml)
    with pytest.raises(UserError, match="has no grown plant"):
        series.vary(files.load_scene("sphere_20mm"), plants=2)


def test_no_variation_replaces_another_of_the_same_name(tmp_path: Path, command: Command) -> None:
    scene = files.load_scene("radish_day05a")
    with pytest.raises(UserError, match="have the same name"):
        series.vary(scene, treatments=(("low N", 0.85, ()), ("low_N", 0.9, ())))
    with pytest.raises(UserError, match="have the same name"):
        series.vary(scene, days=(5.01, 5.04))
    words = ("batch", "simulate", "radish_day05a", "radish_day05a", "--plants", 2, "-o", tmp_path / "scans")
    command.fails(*words, named=["two scenes have the same name"])


def test_what_lies_in_the_way_of_a_batch_is_one_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: Command) -> None:
    pytest.importorskip("dask_jobqueue")
    scan = dataset(tmp_path / "scans" / "ball")
    monkeypatch.setenv("PATH", "")
    command.fails("batch", scan, "-o", tmp_path / "r", "--cluster", "slurm", named=["sbatch was not found"])
    (scan / "dataset.json").unlink()
    os.mkfifo(scan / "dataset.json")  # it fails by itself, and holds nobody up
    (one,) = collect.reconstructions([str(scan)], str(tmp_path / "r"), voxel_mm=None, settings=None, device="cpu")
    places.write(one.record, b"[" * 100_000)
    assert not jobs.is_done(one)
    (tmp_path / "r" / "ball").symlink_to(tmp_path)
    command.fails("batch", scan, "-o", tmp_path / "r", named=["r/ball: a batch does not write through symbolic links"])


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


def test_slurm_asks_for_the_memory_of_the_largest_job(tmp_path: Path) -> None:
    pytest.importorskip("dask_jobqueue")
    program = (
        "from pathlib import Path; from rhizotwin.batches import cluster; from rhizotwin.batches.jobs import Job\n"
        "if __name__ == '__main__':\n"
        "    one = Job(name='a', kind='reconstruct', source='s', output='o', key='k', pixels=20e6, options={})\n"
        "    with cluster.slurm([one]) as made: print(made.job_script())\n"
    )
    (tmp_path / "ask.py").write_text(program, encoding="utf-8")
    done = subprocess.run([sys.executable, str(tmp_path / "ask.py")], capture_output=True, text=True, timeout=120, check=True)
    assert "#SBATCH --mem=4G" in done.stdout  # 700 + 120 * 20 = 3100 MiB, in whole GB as SLURM is asked
