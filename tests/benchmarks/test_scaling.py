"""How reconstructions grow: exponents."""

import cv2
import numpy as np
import pytest

from benchmarks import scaling
from benchmarks.scaling import Point


def test_exponents_are_slopes_of_the_logarithms() -> None:
    points = [Point(value=x, cpu_s=3.0 * x**1.5, memory_mib=200.0 * x**0.25) for x in (1.0, 2.0, 5.0)]
    found = scaling.growth("views", points)
    assert found.cpu == pytest.approx(1.5)
    assert found.memory == pytest.approx(0.25)
    assert "| views | 1 | 5 | 3.0 -> 33.5 | 1.50 | 200 -> 299 | 0.25 |" in scaling.table([found])
    image = cv2.imdecode(np.frombuffer(scaling.draw([found]), np.uint8), cv2.IMREAD_GRAYSCALE)
    assert image.min() < 100  # something is drawn
