"""Roots against the true ones."""

from dataclasses import replace

import numpy as np
import pytest

from rhizotwin.scenes.rsml import Root
from rhizotwin.scoring import score_roots
from tests.recon.strings import TRUNK
from tests.roots import straight


def test_score_of_equal_and_of_shifted_roots():
    root = Root(points_mm=TRUNK, diameters_mm=np.full(len(TRUNK), 0.4), order=0, parent=-1)
    same = score_roots.compare_roots([root], [root])
    assert (same.length_error, same.recall, same.precision, same.tip_recall) == (0.0, 1.0, 1.0, 1.0)
    half = Root(points_mm=TRUNK[:151] + np.array([0.1, 0.0, 0.0]), diameters_mm=np.full(151, 0.5), order=0, parent=-1)
    score = score_roots.compare_roots([half], [root])
    assert score.length_error == pytest.approx(-0.5, abs=0.01)
    assert score.recall == pytest.approx(0.5, abs=0.03)
    assert score.precision == 1.0
    assert score.radius_error_median == pytest.approx(0.25)
    assert score.tip_recall == 0.0
    unseen = score_roots.compare_roots([root, replace(half, tip_seen=False)], [root])
    assert (unseen.tips, unseen.tip_precision) == (1, 1.0)
    assert unseen.length_error == pytest.approx(0.5, abs=0.01)
    none = score_roots.compare_roots([replace(root, tip_seen=False)], [root])
    assert (none.tips, none.tip_precision, none.tip_recall) == (0, 0.0, 0.0)


def with_tip(x_mm: float) -> Root:
    return straight((x_mm, 0.0, 0.0), (x_mm, 0.0, -10.0))


def test_a_tip_matches_one_tip_only():
    true = [with_tip(5.0 * k) for k in range(4)]
    tenfold = score_roots.compare_roots([with_tip(5.0 * k + 0.01 * copy) for k in range(4) for copy in range(10)], true)
    assert (tenfold.tips, tenfold.tip_recall, tenfold.tip_precision) == (40, 1.0, 0.1)
    # the first found tip reaches both true tips, the second one only the first true tip
    beside = score_roots.compare_roots([with_tip(0.4), with_tip(-0.8)], [with_tip(0.0), with_tip(0.9)])
    assert (beside.tip_recall, beside.tip_precision) == (1.0, 1.0)
    apart = score_roots.compare_roots([with_tip(50.0)], true)
    assert (apart.tip_recall, apart.tip_precision) == (0.0, 0.0)
