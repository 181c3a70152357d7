"""Wires of known section: matched by diameter, compared per length."""

from pathlib import Path

import numpy as np
import pytest

from rhizotwin.experiment.phantom import diameter_of, measure_wires
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.rsml import Root, write_rsml
from tests.command import Command

WIRES = (0.1, 0.2, 0.4, 0.8)


def _wire(diameter_mm: float, length_mm: float, x: float) -> Root:
    z = np.linspace(-12.0, -12.0 - length_mm, 7)
    return Root(points_mm=np.stack([np.full(7, x), np.zeros(7), z], axis=1), diameters_mm=np.full(7, diameter_mm), order=0, parent=-1)


def test_sections_by_hand(ball_result):
    folder = ball_result("wires")
    assert diameter_of(1000.0 * np.pi / 4.0 * 8.96) == pytest.approx(1.0)  # a metre of 1 mm wire has pi / 4 times 8.96 g
    wires = [(0.101, 60.0, 0.0), (0.2, 30.0, 10.0), (0.2, 28.0, 10.0), (0.43, 59.0, 20.0), (0.8, 4.0, 30.0), (3.0, 9.0, 40.0)]
    roots = [_wire(*one) for one in wires]
    write_rsml(folder / "roots.rsml", roots)
    thin, pieces, thick, short = measure_wires(folder, WIRES)
    assert (thin.length_mm, thin.error) == (pytest.approx(60.0), pytest.approx(0.0201, abs=1e-4))
    assert (pieces.length_mm, pieces.error) == (pytest.approx(58.0), pytest.approx(0.0, abs=1e-6))
    assert thick.error == pytest.approx(1.075**2 - 1.0, abs=1e-4)
    assert [one.verdict for one in (thin, pieces, thick, short)] == [
        "measured within 3 %",
        "measured within 3 %",
        "not measurable within 3 %",
        "not measurable: less than 10 mm of the wire were detected",
    ]


def test_command_and_mistakes(ball_result, tmp_path: Path, command: Command):
    with pytest.raises(UserError, match="too similar"):
        measure_wires(tmp_path, (0.4, 0.5))
    with pytest.raises(UserError, match=r"result\.json does not exist; specify a folder"):
        measure_wires(tmp_path / "missing", WIRES)
    with pytest.raises(UserError, match="found no centre lines"):
        measure_wires(folder := ball_result("r"), WIRES)
    write_rsml(folder / "roots.rsml", [_wire(diameter, 60.0, 10.0 * k) for k, diameter in enumerate(WIRES)])
    assert command.works("phantom", folder).out.count("measured within 3 %") == 4
    assert command("phantom", folder, "--mg-per-m", "60,283,1129,4493").code == 1
    (folder / "result.json").write_text("{")
    command.fails("phantom", folder, named=["result.json could not be read"])


@pytest.mark.nightly
def test_wires_on_the_twin(tmp_path: Path, command: Command):
    """Each wire is measured within 3 % on a bench."""
    command.works("simulate", "wire_phantom", "-o", tmp_path / "d", "--profile", "bench", "--quiet")
    command.works("reconstruct", tmp_path / "d", "-o", tmp_path / "r", "--quiet")
    assert command.works("phantom", tmp_path / "r").out.count("  measured within 3 %") == 4
