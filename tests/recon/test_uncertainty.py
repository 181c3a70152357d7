"""The volume's error budget: how terms add up, what the verdict says, and what tubes and silhouettes leave open."""

import numpy as np
import pytest

from recon.uncertainty import LEAST_VIEWS, Budget, Term


def term(less_mm3: float, more_mm3: float, name: str = "outlines") -> Term:
    return Term(name=name, less_mm3=less_mm3, more_mm3=more_mm3, why=f"of the {name}")


def test_terms_add_in_quadrature_on_each_side() -> None:
    budget = Budget(volume_mm3=100.0, terms=(term(3.0, 6.0), term(4.0, 8.0)), views=40)
    np.testing.assert_allclose(budget.interval_mm3, (95.0, 110.0))
    assert budget.doubts == ()
    assert "between 95 and 110 mm3" in budget.verdict


def test_the_interval_never_reaches_below_nothing() -> None:
    assert Budget(volume_mm3=10.0, terms=(term(20.0, 1.0),), views=40).interval_mm3[0] == 0.0


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"views": LEAST_VIEWS - 1}, "only 7 views"),
        ({"unexplained": 0.3}, "30 % of what the pictures show"),
        ({"fill": 0.6}, "60 % of the root zone"),
        ({"terms": (term(1.0, 1.0), term(2.0, 40.0, "missing roots"))}, "of the missing roots"),
    ],
    ids=["views", "unexplained", "fill", "interval"],
)
def test_what_is_no_measurement_is_said_with_its_cause(changes: dict[str, object], says: str) -> None:
    budget = Budget(**({"volume_mm3": 100.0, "terms": (term(3.0, 3.0),), "views": 40} | changes))  # type: ignore[arg-type]
    assert budget.verdict.startswith("this scan cannot give a volume: ")
    assert says in budget.verdict
