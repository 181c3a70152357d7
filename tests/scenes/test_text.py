"""Words of messages: numbers with their nouns, names that were meant, versions."""

import platform

import numpy as np
import pytest

from rhizotwin.scenes.formatting import count
from rhizotwin.scenes.name_suggestion import most_similar
from rhizotwin.scenes.provenance import versions


def test_numbers_have_their_nouns_and_libraries_their_versions() -> None:
    assert [count(k, "dataset") for k in range(3)] == ["0 datasets", "1 dataset", "2 datasets"]
    assert [count(k, "entry", "entries") for k in (1, 3)] == ["1 entry", "3 entries"]
    found = versions(["numpy", "no-such-distribution"])
    assert list(found) == ["rhizotwin", "python", "numpy", "no-such-distribution"]
    assert list(found.values())[1:] == [platform.python_version(), np.__version__, "unknown"]


@pytest.mark.parametrize(
    ("word", "known", "meant"),
    [
        ("radish_day5", ["radish_day15a", "radish_day15b", "radish_day05a", "radish_day05b", "radish_day30a"], "radish_day05a"),
        ("radish_day15", ["radish_day05a", "radish_day15b", "radish_day15a"], "radish_day15b"),
        ("spere_20mm", ["sphere_20mm", "sphere_2mm"], "sphere_20mm"),
        ("s", ["sphere", "spere"], None),
        ("", ["wall_mm"], None),
    ],
)
def test_the_name_that_was_meant(word: str, known: list[str], meant: str | None):
    assert most_similar(word, known) == meant
