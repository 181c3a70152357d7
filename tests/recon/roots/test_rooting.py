"""The last fit of the tubes, and what is removed after it."""

from dataclasses import replace

import numpy as np
import pytest

from rhizotwin.recon.roots import rooting
from rhizotwin.scenes.monitor import Monitor
from tests.recon.strings import TRUNK, TWIG, at_rest, line, pictured, strung


def test_a_branch_that_no_picture_shows_is_removed_after_the_last_fit() -> None:
    """After the fit, the branch is as thin as tubes can be; without its removal, its length would still count."""
    false = line((0.0, 0.0, -25.0), (-8.0, 4.0, -30.0), (-10.0, 6.0, -45.0))
    true, found = strung(TRUNK, TWIG), strung(TRUNK, TWIG, false)
    tree = replace(at_rest(found, px_a_mm=3.2), evidence=pictured(true, noise=0.003))
    system = rooting.finish_tree(tree, monitor=Monitor())
    assert len(system.tubes.branches) == 2
    assert system.tubes.length_mm == pytest.approx(true.length_mm, rel=0.01)
    assert len(system.solid) == len(system.uncertain) == len(system.tubes.radius_mm)
    assert np.median(system.tubes.radius_mm) == pytest.approx(0.2, rel=0.05)
