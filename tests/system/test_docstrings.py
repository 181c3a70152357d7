"""Docstrings are numpydoc: what a parameter is stands beside its name, what it means below."""

import ast
import re
from collections.abc import Iterator
from itertools import pairwise

import pytest

from tests.system.sources import FILES, ROOT

NAME = re.compile(r"\*{0,2}\w+(, \*{0,2}\w+)*")
ARRAY = re.compile(r"\b(Array|NDArray|Mask|Image|Floats|Index|Faces)\b")
MANY = re.compile(r"tuple|Array|Mask|Image|Floats")
"""What comes back with a shape, or in an order."""
SHAPE = re.compile(r"\((\.\.\.|\d+[,)]|[A-Z]\b|[a-z]+,|[a-z]+\^|\d [A-Z]|ny,)|\dx\d|rows")
"""A shape in a docstring: ``(N, 3)``, ``(...)``, 4x4, rows and columns."""
FEW = {"benchmarks": 2, "rig": 2, "scenes": 2, "sim": 2}
"""So many parameters may be told in the sentence alone; in the other packages 3."""
HELP = ("rhizotwin/commands/", "rhizotwin/viewer/")
"""Commands, whose docstrings are their help, and what answers clicks."""


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


def _public(body: list[ast.stmt]) -> Iterator[ast.FunctionDef]:
    """Yield public functions and methods that are no properties."""
    for node in body:
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            yield from _public(node.body)
        elif isinstance(node, ast.FunctionDef) and not node.name.startswith("_"):
            decorators = [ast.unparse(one) for one in node.decorator_list]
            if not any(one.endswith(("setter", "overload", "override")) for one in decorators):
                yield node


def untold(source: str, few: int) -> list[str]:
    """Return the functions of a module whose arrays have no shape, or whose parameters are not told."""
    found = []
    for function in _public(ast.parse(source).body):
        given = [
            one for one in (*function.args.posonlyargs, *function.args.args, *function.args.kwonlyargs) if one.arg not in ("self", "cls")
        ]
        text = ast.get_docstring(function) or ""
        types = " ".join(ast.unparse(one) for one in (*(one.annotation for one in given), function.returns) if one is not None)
        if ARRAY.search(types) and not SHAPE.search(text):
            found.append(f"{function.name}: no shape")
        if len(given) > few and "Parameters\n---" not in text:
            found.append(f"{function.name}: no parameters")
        told = re.search(r"(Returns|Yields)\n---", text) or (len(given) <= few or few != 2)
        if function.returns is not None and MANY.search(ast.unparse(function.returns)) and not told:
            found.append(f"{function.name}: no returns")
    return found


@pytest.mark.parametrize("file", [file for file in FILES if not file.startswith(HELP)])
def test_shapes_and_parameters_are_told(file: str) -> None:
    assert untold((ROOT / file).read_text(encoding="utf-8"), FEW.get(file.partition("/")[0], 3)) == []


def test_what_is_not_told_is_found() -> None:
    rows = ["def a(x: Array) -> Array:", "    'Double numbers.'", "def b(x: Array) -> Array:", "    'Double (N,) numbers.'"]
    assert untold("\n".join([*rows, "def c(x: int, y: int, z: int) -> tuple[int, int]:", "    'Add.'"]), 2) == [
        "a: no shape",
        "c: no parameters",
        "c: no returns",
    ]


@pytest.mark.parametrize("file", FILES)
def test_parameters_have_a_type_and_below_it_what_they_mean(file: str) -> None:
    assert loose((ROOT / file).read_text(encoding="utf-8")) == []


def test_a_meaning_in_the_place_of_the_type_is_found() -> None:
    rows = ["Do.", "", "Parameters", "----------", "a : (N,) where it is. Then.", "b", "    What.", "c : int", "    How."]
    source = "def f(a, b, c):\n    " + repr("\n".join(rows)) + "\n"
    assert loose(source) == ["f: a : (N,) where it is. Then.", "f: b"]
