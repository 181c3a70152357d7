"""Centre lines and their parts."""

import numpy as np
import pytest

from rhizotwin.corrections import lines


def test_a_line_knows_its_nearest_point_and_parts():
    line = lines.Line(np.array([[0.0, 0, 0], [0, 0, -10]]), np.array([1.0, 0.5]), -1, (lines.Piece(0, 0.0, 10.0),))
    assert line.nearest_mm((3.0, 0.0, -4.0)) == pytest.approx(4.0)
    part = line.between(2.0, 6.0)
    assert part.length_mm == pytest.approx(4.0)
    assert part.pieces == (lines.Piece(0, 2.0, 6.0),)
    assert part.backward().between(1.0, 2.0).pieces == (lines.Piece(0, 5.0, 4.0),)
    assert part.diameters_mm == pytest.approx([0.9, 0.7])
