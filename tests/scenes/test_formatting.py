"""Numbers with their nouns."""

import pytest

from rhizotwin.scenes.formatting import count


@pytest.mark.parametrize(("number", "said"), [(0, "0 datasets"), (1, "1 dataset"), (2, "2 datasets")])
def test_number_with_its_noun(number: int, said: str) -> None:
    assert count(number, "dataset") == said


def test_irregular_plural() -> None:
    assert [count(k, "entry", "entries") for k in (1, 3)] == ["1 entry", "3 entries"]
