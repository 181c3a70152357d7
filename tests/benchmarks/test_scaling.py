"""How reconstructions grow: exponents."""

import json
from pathlib import Path

import pytest

from benchmarks import against, scaling
from benchmarks.__main__ import main
from benchmarks.against import Used
from benchmarks.scaling import Point


def test_exponents_are_slopes_of_the_logarithms() -> None:
    points = [Point(value=x, cpu_s=3.0 * x**1.5, memory_mib=200.0 * x**0.25) for x in (1.0, 2.0, 5.0)]
    found = scaling.growth("views", points)
    assert found.cpu == pytest.approx(1.5)
    assert found.memory == pytest.approx(0.25)
    assert "| views | 1 | 5 | 3.0 -> 33.5 | 1.50 | 200 -> 299 | 0.25 |" in scaling.table([found])


def test_pictures_are_rendered_once_and_each_point_is_run_twice(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("RHIZOTWIN_CACHE", str(tmp_path / "cache"))
    ran: list[list[str]] = []

    def run_once(_root: Path, words: list[str]) -> Used:
        ran.append(words)
        if words[0] == "simulate":
            folder = Path(words[words.index("-o") + 1])
            folder.mkdir()
            (folder / "dataset.json").touch()
        voxel_mm = float(words[words.index("--voxel-mm") + 1]) if "--voxel-mm" in words else 1.0
        return Used(cpu_s=1.0 / voxel_mm**2, wall_s=1.0, memory_mib=100.0)

    monkeypatch.setattr(against, "run_once", run_once)
    assert main(["scaling", "--quick", "--axes", "1/voxel_mm", "-o", str(tmp_path / "growth.json")]) == 0
    assert [words[0] for words in ran] == ["simulate", *4 * ["reconstruct"]]
    (growth,) = json.loads((tmp_path / "growth.json").read_text())["growths"]
    assert growth["cpu"] == pytest.approx(2.0)
    assert growth["memory"] == pytest.approx(0.0)
    assert "| 1/voxel_mm |" in capsys.readouterr().out
