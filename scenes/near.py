"""The name that somebody meant who typed another."""

import difflib
import re
from collections.abc import Iterable

ALIKE = 0.6
"""Share of letters in common (`difflib`) below which a name was not meant."""


def nearest(word: str, known: Iterable[str]) -> str | None:
    """Return the known name that was probably meant, or None.

    A name that the word begins comes first (``wall``: ``wall_mm``, not ``n_wall``), zeros before numbers left aside
    (``radish_day5``: ``radish_day05a``, not ``radish_day15a``); then the one with most letters in common.
    """
    names = list(known)
    typed = _plain(word)
    begun = [name for name in names if _begins(typed, _plain(name))]
    if typed and begun:
        return min(begun, key=len)
    alike = difflib.get_close_matches(word, names, n=1, cutoff=ALIKE)
    return alike[0] if alike else None


def _plain(name: str) -> str:
    """Return a name with its numbers written without leading zeros."""
    return re.sub(r"\d+", lambda number: str(int(number[0])), name.casefold())


def _begins(word: str, name: str) -> bool:
    """Tell whether a word is the beginning of a name, and does not end within a number of it or among its letters."""
    rest = name[len(word) :]
    if not name.startswith(word):
        return False
    return not rest or rest[0] in "_-. " or (word[-1:].isdigit() and not rest[0].isdigit())
