"""Docstrings are numpydoc: what a parameter is stands beside its name, what it means below."""

import ast
import re
from itertools import pairwise

import pytest

from tests.system.sources import FILES, ROOT

NAME = re.compile(r"\*{0,2}\w+(, \*{0,2}\w+)*")


def loose(source: str) -> list[str]:
    """Return the lines of "Parameters" and "Returns" that are not a name or type with its meaning below."""
    found = []
    for function in ast.walk(ast.parse(source)):
        if not isinstance(function, ast.FunctionDef | ast.AsyncFunctionDef):
            continue
        lines = (ast.get_docstring(function) or "").splitlines()
        section = ""
        for line, below in pairwise([*lines, ""]):
            if below.startswith("---"):
                section = line
            elif section in ("Parameters", "Returns") and line[:1].strip() and not line.startswith("---"):
                name, typed, _ = line.partition(" : ")
                plain = section == "Parameters" and not (typed and NAME.fullmatch(name))
                crowded = bool(typed) and bool(re.search(r"\.$|: ", line.partition(" : ")[2]))
                if plain or crowded:
                    found.append(f"{function.name}: {line}")
    return found


@pytest.mark.parametrize("file", FILES)
def test_parameters_have_a_type_and_below_it_what_they_mean(file: str) -> None:
    assert loose((ROOT / file).read_text(encoding="utf-8")) == []


def test_a_meaning_in_the_place_of_the_type_is_found() -> None:
    rows = ["Do.", "", "Parameters", "----------", "a : (N,) where it is. Then.", "b", "    What.", "c : int", "    How."]
    source = "def f(a, b, c):\n    " + repr("\n".join(rows)) + "\n"
    assert loose(source) == ["f: a : (N,) where it is. Then.", "f: b"]
