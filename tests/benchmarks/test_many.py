"""The benchmark of a batch: its scans differ by plant, one is damaged, and its own seconds are those of no scan."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks import many
from rhizotwin.scenes import atomic
from rhizotwin.scenes.dataset import Dataset, Frame, load_dataset, save_dataset
from rhizotwin.scenes.model import Scene


def test_scans_are_plants_of_their_own_and_one_is_damaged(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(many, "COUNT", 2)
    monkeypatch.setattr(many, "DAMAGED", 2)
    master = tmp_path / "master"
    atomic.write_image(master / "images" / "a.png", np.random.default_rng(0).integers(0, 65535, (30, 40)).astype(np.uint16))
    save_dataset(Dataset(folder=master, scene=Scene(), frames=(Frame(file="images/a.png", sha256=""),)))
    many._scans(tmp_path / "scans", lambda _: None)
    one, two = (load_dataset(tmp_path / "scans" / f"plant_0{number}") for number in (1, 2))
    assert (one.scene.subject.plant, two.scene.subject.plant) == ("plant_01", "plant_02")
    whole, half = ((each.folder / "images" / "a.png").stat().st_size for each in (one, two))
    assert half == whole // 2


def test_its_own_seconds_are_those_of_no_scan() -> None:
    night = many.Night(scans=18, results=17, sentences=("failed",), twice=0, killed=1, code=2, wall_s=200.0, jobs_s=190.0)
    assert night.own_s == 10.0
    assert night.share(60.0) == pytest.approx(10.0 / 1090.0)
    assert many.lines(night, 60.0)[0] == "17 results of 18 scans, 1 process killed, 0 done twice, exit code 2"
    assert many.plain(night)["own_s"] == 10.0
