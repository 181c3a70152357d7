"""Tests have short names and cannot be vacuous: an assertion in a loop is never reached where there is nothing to iterate over."""

import ast
from collections.abc import Iterator

from tests.lint.lengths import Function

MAX_NAME = 60
Loop = ast.For | ast.AsyncFor | ast.While


def check(_file: str, tree: ast.Module, _lines: list[str]) -> Iterator[tuple[int, str]]:
    """Yield line and message of each empty loop, and of each test with a long name or with assertions in loops only."""
    for node in ast.walk(tree):
        if isinstance(node, Loop) and all(is_empty(statement) for statement in node.body):
            yield node.lineno, "a loop without a body: call list() or a function that consumes the iterable, or wait on an event"
        if isinstance(node, Function) and node.name.startswith("test"):
            if len(node.name) > MAX_NAME:
                yield node.lineno, f"{node.name} has {len(node.name)} characters, at most {MAX_NAME}"
            places = list(assertions(node, in_loop=False))
            if places and all(places):
                yield node.lineno, f"{node.name} asserts in loops only and passes if they are empty: parametrize it, or compare whole lists"


def is_empty(statement: ast.stmt) -> bool:
    """Return whether a statement is ``pass`` or ``...``."""
    ellipsis = isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant) and statement.value.value is ...
    return isinstance(statement, ast.Pass) or ellipsis


def assertions(node: ast.AST, *, in_loop: bool) -> Iterator[bool]:
    """Yield for each ``assert`` and ``with pytest.raises`` or ``pytest.warns`` below a node whether it is in a loop."""
    if isinstance(node, ast.Assert) or (isinstance(node, ast.With | ast.AsyncWith) and any(is_expected(item) for item in node.items)):
        yield in_loop
    looped = node.body if isinstance(node, Loop) else []
    for child in ast.iter_child_nodes(node):
        yield from assertions(child, in_loop=in_loop or child in looped)


def is_expected(item: ast.withitem) -> bool:
    """Return whether a context is ``pytest.raises`` or ``pytest.warns``."""
    return ast.unparse(item.context_expr).startswith(("pytest.raises(", "pytest.warns("))
