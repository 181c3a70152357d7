"""What a batch refuses, and faults that are not those of a scan."""

import os
from pathlib import Path

import pytest

from rhizotwin.batches import collect, jobs, places, work
from rhizotwin.batches.jobs import Job, Outcome
from rhizotwin.batches.run import LOCK, run
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.lock import lock_file
from tests.command import Command
from tests.rhizotwin.batches.conftest import dataset, job


def test_what_cannot_be_run_is_one_sentence(tmp_path: Path, command: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    command.fails("batch", tmp_path, "-o", tmp_path / "r", named=["no dataset was found"])
    pytest.importorskip("distributed")
    monkeypatch.setattr("rhizotwin.batches.cluster.WAIT_S", 0.5)
    words = ("batch", dataset(tmp_path / "scans" / "a").parent, "-o", tmp_path / "r", "--cluster", "tcp://127.0.0.1:9")
    assert "the Dask scheduler could not be reached" in command(*words).err


def test_a_full_disk_is_not_the_scans_fault(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(_: Job) -> None:
        raise OSError(28, "No space left on device", "result")

    monkeypatch.setattr(work, "_reconstruct", full)
    outcome = Outcome(**work.work(job("a", tmp_path).plain()))
    assert (outcome.state, outcome.sentence) == ("again", "result: the disk is full; free some space and run the same command again")


def test_two_batches_do_not_work_in_one_folder(tmp_path: Path) -> None:
    with lock_file(tmp_path / LOCK, what="it"), pytest.raises(UserError, match="is using it"):
        run([job("a", tmp_path)], str(tmp_path))


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
