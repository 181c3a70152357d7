"""Numbers of cells."""

import numpy as np

from rhizotwin.recon.hull.boxes import Box


def test_numbers_are_those_of_numpy_and_give_the_cells_back() -> None:
    index = np.random.default_rng(0).integers(-9, 9, (200, 3)).astype(np.int32)
    box = Box.around(index)
    np.testing.assert_array_equal(box.number(index), np.ravel_multi_index(tuple((index - box.low).T), tuple(box.span)))
    np.testing.assert_array_equal(box.cell(box.number(index)), index)
    np.testing.assert_array_equal(box.number(index + np.array([0, 0, 1])) - box.number(index), 1)


def test_no_cells_lie_in_a_box_of_one() -> None:
    assert len(Box.around(np.zeros((0, 3), np.int32)).number(np.zeros((0, 3), np.int32))) == 0
