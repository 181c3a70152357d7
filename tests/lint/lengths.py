"""Functions are short and take few parameters."""

import ast
from collections.abc import Iterator

MAX_LINES = 60
MAX_PARAMETERS = 8

Function = ast.FunctionDef | ast.AsyncFunctionDef


def parameters(function: Function) -> list[ast.arg]:
    """Return the parameters of a function without ``self`` and ``cls``."""
    given = [*function.args.posonlyargs, *function.args.args, *function.args.kwonlyargs]
    return [one for one in given if one.arg not in ("self", "cls")]


def check(_file: str, tree: ast.Module, _lines: list[str]) -> Iterator[tuple[int, str]]:
    """Yield line and message of each function that is too long or takes too much."""
    for function in ast.walk(tree):
        if isinstance(function, Function):
            count = (function.end_lineno or function.lineno) - function.lineno + 1
            if count > MAX_LINES:
                yield function.lineno, f"{function.name} has {count} lines, at most {MAX_LINES}"
            if (given := len(parameters(function))) > MAX_PARAMETERS:
                yield function.lineno, f"{function.name} has {given} parameters, at most {MAX_PARAMETERS}"
