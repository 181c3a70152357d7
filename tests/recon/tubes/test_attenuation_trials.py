"""Trials are told apart by the scatter of roots and views."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from rhizotwin.recon.tubes.attenuation_trials import Trial, Trials

ROOTS, NODES, VIEWS = 16, 10, 25


def trial(loss: np.ndarray) -> Trial:
    tubes: Any = None
    return Trial(1.0, 0.0, tubes, loss, float(loss.sum()))


@pytest.fixture
def trials() -> Trials:
    nothing: Any = None
    nodes: Any = SimpleNamespace(owner=np.repeat(np.arange(ROOTS), NODES))
    return Trials(nothing, nothing, nothing, nodes, np.ones((VIEWS, ROOTS * NODES), bool))


def test_what_only_scatters_is_not_told_apart(trials: Trials) -> None:
    rng = np.random.default_rng(3)
    zero = trial(np.zeros((VIEWS, ROOTS * NODES)))
    found = [trials.significance(trial(rng.normal(size=(VIEWS, ROOTS * NODES))), zero) for _ in range(200)]
    assert np.std(found) == pytest.approx(0.7, abs=0.15), "roots and views both count: on the safe side by the root of two"
    assert abs(np.mean(found)) < 0.2


def test_roots_that_scatter_together_count_as_one_each(trials: Trials) -> None:
    """Errors that a root has in all views are no more telling for being seen often."""
    rng = np.random.default_rng(4)
    zero = trial(np.zeros((VIEWS, ROOTS * NODES)))
    shared = [np.tile(np.repeat(rng.normal(size=ROOTS), NODES), (VIEWS, 1)) for _ in range(200)]
    assert np.std([trials.significance(trial(loss), zero) for loss in shared]) == pytest.approx(1.0, abs=0.15)


def test_a_difference_in_all_is_at_most_the_root_of_their_number_unless_scatter_about_it_is_asked(trials: Trials) -> None:
    rng = np.random.default_rng(5)
    more, zero = trial(1.0 + 0.01 * rng.normal(size=(VIEWS, ROOTS * NODES))), trial(np.zeros((VIEWS, ROOTS * NODES)))
    assert trials.significance(more, zero) == pytest.approx(ROOTS**0.5, rel=0.01)
    assert trials.significance(zero, more) == pytest.approx(-trials.significance(more, zero))
    assert trials.behind(more, zero) > 100.0
