"""A plant in several bands, from the twin's reflectances to the indices in the table."""

import json
from pathlib import Path

import pytest

from tests.command import Command

pytestmark = pytest.mark.nightly


def test_indices_of_a_shoot_are_those_of_its_reflectances(command: Command, tmp_path: Path) -> None:
    scan, found = tmp_path / "scan", tmp_path / "found"
    assert (
        command("simulate", "radish_bands", "-o", scan, "--profile", "bench", "--views", "8", "--image-wh", "400x300", "--quiet").code == 0
    )
    assert command("reconstruct", scan, "-o", found, "--voxel-mm", "0.5", "--quiet").code == 0
    truth = json.loads((scan / "truth" / "truth.json").read_text())["shoot"]
    shoot = json.loads((found / "result.json").read_text())["shoot"]
    for name in ("ndvi", "ndre"):
        assert shoot[name] == pytest.approx(truth[name], abs=0.02)
    assert shoot["reflectance_blue"] < shoot["reflectance_green"] < shoot["reflectance_red_edge"] < shoot["reflectance_nir"]
    table = command("traits", found, "--output", tmp_path / "t.csv")
    assert table.code == 0, table.err
    head, row = (line.split(",") for line in (tmp_path / "t.csv").read_text().splitlines()[:2])
    assert float(row[head.index("ndvi")]) == pytest.approx(truth["ndvi"], abs=0.02)
