"""Roots of a refined tree with solids."""

import json
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from rhizotwin.recon.roots.root_tree import RootSystem
from rhizotwin.recon.tubes.tubes import Tubes


@pytest.mark.parametrize(
    ("first", "end", "tips"), [(40, 40, [True]), (15, 25, [False, True]), (15, 40, [False])], ids=["no solid", "through a solid", "into it"]
)
def test_a_root_that_enters_a_solid_has_no_tip_there(first: int, end: int, tips: list[bool]) -> None:
    centre_mm = np.zeros((40, 3))
    centre_mm[:, 2] = -10.0 - 0.6 * np.arange(40)
    solid = (np.arange(40) >= first) & (np.arange(40) < end)
    tubes = Tubes(centre_mm, np.full(40, 0.4), (np.arange(40),))
    tree = SimpleNamespace(tubes=tubes, solid=solid, uncertain=np.zeros(40, bool))
    found = [root.tip_seen for root in RootSystem.roots(cast(RootSystem, tree))]
    assert json.dumps(found) == json.dumps(tips)  # NumPy's values cannot be written as JSON
