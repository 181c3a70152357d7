"""The measure of growth: which true root a found one is, and how many links are right."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks import growth
from rhizotwin.experiment.matching import Day, follow
from rhizotwin.scenes.rsml import Root


def root(label: str, x_mm: float, length_mm: float, *, parent: int = -1, y_mm: float = 0.0) -> Root:
    points = np.stack([np.full(21, x_mm), np.full(21, y_mm), -np.linspace(0.0, length_mm, 21)], axis=1)
    return Root(points_mm=points, diameters_mm=np.full(21, 0.4), order=0, parent=parent, label=label)


def test_a_found_root_has_the_name_of_the_true_one_that_holds_most_of_it() -> None:
    true = {"1": root("1", 0.0, 30.0), "1.1": root("1.1", 5.0, 20.0)}
    half = replace(root("", 0.1, 30.0), points_mm=root("", 0.1, 30.0).points_mm[10:])
    found = [half, root("", 0.2, 14.0), root("", 5.3, 18.0), root("", 20.0, 18.0)]
    assert growth.named(found, true) == ["1", "", "1.1", ""]  # of two pieces the longer has the name


def test_links_are_counted_by_the_true_names(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(growth, "DAYS", (5.0, 7.0))
    true = [{"1": root("1", 0.0, 20.0), "1.1": root("1.1", 8.0, 6.0)}, {"1": root("1", 0.0, 30.0), "1.1": root("1.1", 8.0, 10.0)}]
    found = [(root("", 0.0, 20.0), root("", 8.0, 6.0)), (root("", 0.0, 31.0), root("", 8.0, 10.0), root("", -9.0, 5.0))]
    followed = follow([Day(day=day, roots=roots) for day, roots in zip(growth.DAYS, found, strict=True)])
    told = growth._checked(followed, [growth.named(roots, of) for roots, of in zip(found, true, strict=True)], true)
    assert (told.linked, told.right, told.both_found, told.both_there) == (2, 2, 2, 2)
    assert (told.precision, told.recall) == (1.0, 1.0)
    assert sorted(told.rate_errors) == pytest.approx([0.0, 0.1], abs=0.02)


def test_treatments_that_differ_much_are_told_apart() -> None:
    pytest.importorskip("statsmodels")
    assert growth.treatments(1, effect=0.6, say=lambda _: None) == [True]
