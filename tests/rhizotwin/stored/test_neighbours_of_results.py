"""Plants that share a canister, from a result's folder."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from rhizotwin.scenes import rsml
from rhizotwin.scenes.rsml import Root
from rhizotwin.stored import result_files


def test_a_results_plants_are_compared(ball_result: Callable[..., Path]) -> None:
    folder = ball_result("together")
    assert result_files.read_neighbours(folder) == ()  # no roots were found
    points = np.linspace((0.0, 0.0, 0.0), (0.0, 0.0, -30.0), 11)
    roots = [
        Root(points_mm=points + np.array([x, 0.0, 0.0]), diameters_mm=np.full(11, 1.0), order=0, parent=-1, plant=plant)
        for plant, x in (("A", 0.0), ("B", 5.0))
    ]
    rsml.write_rsml(folder / "roots.rsml", roots)
    (pair,) = result_files.read_neighbours(folder)
    assert pair.plants == ("A", "B")
    assert pair.nearest_mm == pytest.approx(4.0, abs=0.01)
    rsml.write_rsml(folder / "roots.rsml", roots[:1])
    assert result_files.read_neighbours(folder) == ()
