"""What somebody meant who typed another name."""

import pytest

from rhizotwin.scenes.name_suggestion import most_similar


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
