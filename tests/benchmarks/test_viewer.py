"""The viewer's benchmark: what a process without a browser answers, and the volume measured afresh."""

from pathlib import Path

import pytest

from benchmarks import viewer, viewer_debris, viewer_server
from benchmarks.__main__ import main
from rhizotwin.corrections import log
from rhizotwin.corrections.session import Session
from tests.rhizotwin import plant as plants


def test_answers_are_timed_and_the_volume_is_measured_afresh(tmp_path: Path) -> None:
    made = plants.make(tmp_path, fibre=True)
    told = viewer_server.answers(made.result, made.dataset)
    assert {"start", "divide", "pick", "delete_root", "undo", "delete_1000_voxels"} <= set(told)
    assert all(seconds >= 0.0 for seconds in told.values())
    assert not (made.result / log.LOG_NAME).exists()
    session = Session(made.result)
    session.do(log.edit("delete roots", roots=[4]))
    session.save()
    assert viewer._afresh(made.result, tmp_path / "corrected") < 1e-3


def test_no_start_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["view", "nowhere", "--repeats", "0"]) == 2
    assert "at least one" in capsys.readouterr().err


def test_debris_is_what_the_clean_scan_has_not(tmp_path: Path) -> None:
    dirty, clean = plants.make(tmp_path / "dirty", fibre=True), plants.make(tmp_path / "clean")
    added = viewer_debris.added_mm(dirty.roots, clean.roots)
    assert len(added) == len(dirty.roots[4].points_mm)
    assert viewer_debris.debris(Session(dirty.result), added) == [4]
    assert viewer_debris.debris(Session(clean.result), added) == []
