"""Suggestion of the known name that is most similar to a misspelt name."""

import difflib
import re
from collections.abc import Iterable

ALIKE = 0.6
"""Minimum similarity (`difflib`) between the given name and a suggestion."""


def most_similar(word: str, known: Iterable[str]) -> str | None:
    """Return the known name that is most similar to a word, or None if no name is similar enough.

    Names that begin with the word are preferred (for ``wall``, ``wall_mm`` rather than ``n_wall``). Leading zeros of
    numbers are ignored (for ``radish_day5``, ``radish_day05a`` rather than ``radish_day15a``).
    """
    names = list(known)
    typed = _plain(word)
    begun = [name for name in names if _begins(typed, _plain(name))]
    if typed and begun:
        return min(begun, key=len)
    alike = difflib.get_close_matches(word, names, n=1, cutoff=ALIKE)
    return alike[0] if alike else None


def _plain(name: str) -> str:
    """Return a name in lower case, and without leading zeros of its numbers."""
    return re.sub(r"\d+", lambda number: str(int(number[0])), name.casefold())


def _begins(word: str, name: str) -> bool:
    """Return whether a name begins with a word. The word must end at a separator, or between a digit and a letter."""
    rest = name[len(word) :]
    if not name.startswith(word):
        return False
    return not rest or rest[0] in "_-. " or (word[-1:].isdigit() and not rest[0].isdigit())
