"""Docstrings are numpydoc: the type of a parameter stands beside its name, its meaning below."""

import ast
import re
from collections.abc import Iterator
from itertools import pairwise

from tests.lint.lengths import Function, parameters

NAME = re.compile(r"\*{0,2}\w+(, \*{0,2}\w+)*")
ARRAY = re.compile(r"\b(Array|NDArray|Mask|Image|Floats|Index|Faces)\b")
MANY = re.compile(r"tuple|Array|Mask|Image|Floats")
"""Return types with a shape or an order."""
SHAPE = re.compile(r"\((\.\.\.|\d+[,)]|[A-Z]\b|[a-z]+,|[a-z]+\^|\d [A-Z]|ny,)|\dx\d|rows")
"""A shape in a docstring: ``(N, 3)``, ``(...)``, 4x4, rows and columns."""
STRICT = ("benchmarks/", "rig/", "scenes/", "sim/")
"""In these packages more than 2 parameters have a section of their own, in the others more than 3."""
HELP = ("rhizotwin/commands/", "rhizotwin/viewer/")
"""Commands, whose docstrings are their help, and the handlers of clicks."""


def check(file: str, tree: ast.Module, _lines: list[str]) -> Iterator[tuple[int, str]]:
    """Yield line and message of each docstring that leaves out shapes or parameters, or mixes type and meaning."""
    if not file.startswith(HELP):
        yield from incomplete(tree, few=2 if file.startswith(STRICT) else 3)
    for function in ast.walk(tree):
        if isinstance(function, Function):
            yield from ((function.lineno, f"{function.name}: {line!r} is no name and type") for line in malformed(function))


def malformed(function: Function) -> Iterator[str]:
    """Yield the lines of "Parameters" and "Returns" that are not a name or type with its meaning below."""
    section = ""
    for line, below in pairwise([*(ast.get_docstring(function) or "").splitlines(), ""]):
        if below.startswith("---"):
            section = line
        elif section in ("Parameters", "Returns") and line[:1].strip() and not line.startswith("---"):
            name, _, kind = line.partition(" : ")
            if (section == "Parameters" and not (kind and NAME.fullmatch(name))) or re.search(r"\.$|: ", kind):
                yield line


def public(body: list[ast.stmt]) -> Iterator[ast.FunctionDef]:
    """Yield public functions and methods, without setters and overloads."""
    for node in body:
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            yield from public(node.body)
        elif isinstance(node, ast.FunctionDef) and not node.name.startswith("_"):
            decorators = [ast.unparse(one) for one in node.decorator_list]
            if not any(one.endswith(("setter", "overload", "override")) for one in decorators):
                yield node


def incomplete(tree: ast.Module, *, few: int) -> Iterator[tuple[int, str]]:
    """Yield the public functions whose arrays have no shape, or that do not describe parameters and returns."""
    for function in public(tree.body):
        given, text = parameters(function), ast.get_docstring(function) or ""
        types = " ".join(ast.unparse(one) for one in (*(one.annotation for one in given), function.returns) if one is not None)
        returns = "" if function.returns is None else ast.unparse(function.returns)
        if ARRAY.search(types) and not SHAPE.search(text):
            yield function.lineno, f"{function.name}: no shape"
        if len(given) > few and "Parameters\n---" not in text:
            yield function.lineno, f"{function.name}: no section Parameters"
        if MANY.search(returns) and 2 == few < len(given) and not re.search(r"(Returns|Yields)\n---", text):
            yield function.lineno, f"{function.name}: no section Returns"
