"""Docstrings and messages use plain technical English: a short list of expressions is rejected, folder by folder."""

import ast
import re
from collections.abc import Iterator, Mapping, Sequence

from tests.lint.lengths import Function

MARKERS = (
    r"\b(tell|tells|told|untold)\b",
    r"^What\b",
    r"\b(is|are) said\b",
    r"\b(hang|hangs) on\b",
    r"\bgoes? before it\b",
    r"\b(nobody|somebody|anybody|whoever)\b",
    r"\bmeanwhile\b",
    r"\bhears?\b",
    r"\b(is|are) taken for\b",
)
"""Regular expressions, matched without regard to case; ``^`` is the beginning of a docstring or message."""
REJECTED: Mapping[str, Sequence[str]] = dict.fromkeys(("benchmarks/", "recon/", "rhizotwin/console/", "rig/", "scenes/", "sim/"), MARKERS)
"""Rejected expressions by folder. Add a folder here, or an expression for one folder only, as soon as it has none left."""
WARN = ("warn", "warning", "UserError")
"""Functions whose arguments are messages, besides those of ``raise``."""


def check(file: str, tree: ast.Module, _lines: list[str]) -> Iterator[tuple[int, str]]:
    """Yield line and message of each docstring and message with a rejected expression."""
    markers = [marker for folder, group in REJECTED.items() if file.startswith(folder) for marker in group]
    if markers:
        pattern = re.compile("|".join(f"(?:{marker})" for marker in markers), re.IGNORECASE)
        for line, text in (*docstrings(tree), *messages(tree)):
            if found := pattern.search(text):
                yield line, f"{found.group()!r} is rejected, see docs/glossary.md: {text.split(chr(10))[0][:80]!r}"


def docstrings(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Yield line and text of the docstrings of modules, classes, functions and attributes."""
    for node in ast.walk(tree):
        body = node.body if isinstance(node, ast.Module | ast.ClassDef | Function) else []
        if isinstance(node, Function):
            body = body[:1]
        for statement in body:
            if isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant) and isinstance(statement.value.value, str):
                yield statement.lineno, statement.value.value.strip()


def messages(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Yield line and text of the string constants that are raised, or passed to a function in `WARN`."""
    for node in ast.walk(tree):
        call = node.exc if isinstance(node, ast.Raise) else node
        if isinstance(call, ast.Call) and (call is not node or ast.unparse(call.func).split(".")[-1] in WARN):
            for part in ast.walk(call):
                if isinstance(part, ast.Constant) and isinstance(part.value, str):
                    yield part.lineno, part.value
