"""Reconstruction of the scans between and after other scans, and update of the growth curves."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from rhizotwin.batches.jobs import Job
from rhizotwin.batches.run import LOCK, Batch
from rhizotwin.catalogue import adding
from rhizotwin.catalogue.store import Catalogue
from rhizotwin.catalogue.verify import check
from rhizotwin.scenes import files
from rhizotwin.scenes.lock import lock_file
from rhizotwin.scenes.model import CapturePlan, Ring
from rhizotwin.timelapse.clocks import VirtualCalendar
from rhizotwin.timelapse.experiment import load_experiment
from rhizotwin.timelapse.reconstruction import Reconstructor
from rhizotwin.timelapse.runner import Listener, Runner


def test_growth_curves_that_a_killed_run_did_not_write(make_experiment, ball_result):
    experiment = load_experiment(make_experiment(plants=1, rounds=1))
    Runner(experiment).prepare()
    page = experiment.results_folder / "growth" / "growth.html"
    with Catalogue.open(experiment.catalogue_path) as catalogue:
        for day in (0.0, 1.0):
            result = ball_result(f"results/P1_{day:g}", subject={"plant": "P1", "treatment": "low N", "day": day})
            adding.add_result(catalogue, result)
        step = partial(Reconstructor(experiment, say=print).step, catalogue, stop=lambda: False)
        assert step()
        written = page.stat().st_mtime_ns
        assert not step()
        assert page.stat().st_mtime_ns == written
        (result / "result.json").touch()
        assert Reconstructor(experiment, say=print).step(catalogue, stop=lambda: False)
        assert page.stat().st_mtime_ns > written


class SlowBatch:
    """Reconstructions that take two hours of virtual time, unless they are stopped."""

    def __init__(self, calendar: VirtualCalendar, patch: pytest.MonkeyPatch) -> None:
        self._calendar = calendar
        self.began, self.stopped = list[str](), list[str]()
        patch.setattr("rhizotwin.catalogue.adding.is_sketch", lambda _: False)
        patch.setattr("rhizotwin.batches.run.run", self.run)

    def run(self, jobs: Sequence[Job], _: str, *, stop: Callable[[], bool], **__: object) -> Batch:
        """Let time pass minute by minute."""
        names = [job.name for job in jobs]
        self.began += names
        for _minute in range(120):
            if stop():
                self.stopped += names
                return Batch(kept=(), done=(), failed=())
            self._calendar.advance(60.0)
        return Batch(kept=(), done=(), failed=tuple((job, "no roots") for job in jobs))


def test_reconstruction_does_not_delay_the_next_scan(make_experiment, monkeypatch: pytest.MonkeyPatch):
    experiment = load_experiment(make_experiment(plants=2, rounds=2, schedule="every_h = 1\nlate_h = 0.5"))
    calendar = VirtualCalendar(experiment.start_utc)
    batch = SlowBatch(calendar, monkeypatch)
    outcome = Runner(experiment, calendar=calendar).run()
    assert (outcome.scanned, outcome.missed) == (4, ())
    assert batch.stopped == ["P1_day_000.00"]
    assert sorted(batch.began[1:]) == ["P1_day_000.00", "P1_day_000.04", "P2_day_000.00", "P2_day_000.04"]


def test_reconstruction_without_its_folder_or_its_time(make_experiment, monkeypatch: pytest.MonkeyPatch):
    """A results folder in use does not end the run, and a reconstruction that would take too long is not begun."""
    experiment, lines = load_experiment(make_experiment(plants=1, rounds=1)), list[str]()
    monkeypatch.setattr("rhizotwin.catalogue.adding.is_sketch", lambda _: False)
    experiment.results_folder.mkdir()
    with lock_file(experiment.results_folder / LOCK, what="results"):
        assert Runner(experiment, listener=Listener(say=lines.append)).run().scanned == 1
    (failed,) = (line for line in lines if line.startswith("the reconstruction of 1 scan failed: "))
    assert "is using it" in failed
    batch, reconstructor = SlowBatch(VirtualCalendar(experiment.start_utc), monkeypatch), Reconstructor(experiment, say=print)
    with Catalogue.open(experiment.catalogue_path) as catalogue:
        stops = iter([False, True, True])
        assert reconstructor.step(catalogue, stop=lambda: next(stops), left_s=60.0)
        assert not reconstructor.step(catalogue, stop=lambda: False, left_s=1e-9)
        assert reconstructor.step(catalogue, stop=lambda: False, left_s=60.0)
    assert batch.began == ["P1_day_000.00"] * 2


@pytest.mark.nightly
def test_rendered_scans_are_reconstructed(tmp_path: Path):
    """A ball: result and rig numbers are in the catalogue."""
    scene = files.load_scene("sphere_20mm")
    plan = CapturePlan(rings=(Ring(views=10),))
    files.save_scene(replace(scene, camera=scene.camera.resized((320, 240)), plan=plan), tmp_path / "scene.toml")
    schedule = '[schedule]\nstart = "2026-12-01T09:00:00+00:00"\nrounds = 1\n[reconstruction]\nvoxel_mm = 0.5\n'
    plant = '[twin]\nfidelity = "render"\n[[plants]]\nname = "P1"\ncanister = 1\nsown = "2026-11-26"\n'
    (tmp_path / "e.toml").write_text(f'name = "ball"\nrig = "twin"\nscene = "scene.toml"\n{schedule}{plant}')
    experiment = load_experiment(tmp_path / "e.toml")
    assert Runner(experiment).run().scanned == 1
    with Catalogue.open(experiment.catalogue_path) as catalogue:
        (first,) = catalogue.results()
        assert (first.plants, first.day) == (("P1",), 5.0)
        assert {"focal_scale", "panel_level", "canister_tilt_deg"} <= set(first.rig_numbers)
        query = "SELECT t.value FROM traits t JOIN results x ON x.id = t.result WHERE t.name = 'volume'"
        assert catalogue.rows(query)[0][0] == pytest.approx(np.pi / 6.0 * 20.0**3, rel=0.05)
        assert check(catalogue) == []
