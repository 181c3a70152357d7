"""Trials are told apart by the scatter of roots and views."""

from types import SimpleNamespace

import numpy as np
import pytest

from rhizotwin.recon.tubes.attenuation_trials import Trial, Trials

ROOTS, NODES, VIEWS = 16, 10, 25
SHAPE = VIEWS, ROOTS * NODES
TRIALS = Trials(None, None, None, SimpleNamespace(owner=np.repeat(np.arange(ROOTS), NODES)), np.ones(SHAPE, bool))


def trial(loss: np.ndarray) -> Trial:
    return Trial(1.0, 0.0, None, loss, float(loss.sum()))


ZERO = trial(np.zeros(SHAPE))


@pytest.mark.parametrize(("shared", "expected"), [(False, 0.7), (True, 1.0)], ids=["views and roots", "roots alone"])
def test_what_only_scatters_is_not_told_apart(shared: bool, expected: float) -> None:
    """Both count, on the safe side by the root of two; errors that a root has in all views tell no more for being seen often."""
    rng = np.random.default_rng(3)
    of_roots = [np.tile(np.repeat(rng.normal(size=ROOTS), NODES), (VIEWS, 1)) for _ in range(200)]
    found = [TRIALS.significance(trial(loss if shared else rng.normal(size=SHAPE)), ZERO) for loss in of_roots]
    assert np.std(found) == pytest.approx(expected, abs=0.15)
    assert abs(np.mean(found)) < 0.2


def test_a_difference_in_all_is_at_most_the_root_of_their_number_unless_scatter_about_it_is_asked() -> None:
    more = trial(1.0 + 0.01 * np.random.default_rng(5).normal(size=SHAPE))
    assert TRIALS.significance(more, ZERO) == pytest.approx(ROOTS**0.5, rel=0.01)
    assert TRIALS.significance(ZERO, more) == pytest.approx(-TRIALS.significance(more, ZERO))
    assert TRIALS.behind(more, ZERO) > 100.0
