"""Functions are short and take few parameters."""

import ast

import pytest

from tests.system.sources import FILES, ROOT

MOST_LINES = 60
MOST_PARAMETERS = 8


def too_long(source: str) -> list[str]:
    """Return the functions of a module that are longer, or take more, than a reader holds in mind."""
    found = []
    for function in ast.walk(ast.parse(source)):
        if not isinstance(function, ast.FunctionDef | ast.AsyncFunctionDef):
            continue
        lines = (function.end_lineno or function.lineno) - function.lineno + 1
        given = [one.arg for one in (*function.args.posonlyargs, *function.args.args, *function.args.kwonlyargs)]
        parameters = len(given) - (given[:1] in (["self"], ["cls"]))
        if lines > MOST_LINES:
            found.append(f"{function.name}: {lines} lines")
        if parameters > MOST_PARAMETERS:
            found.append(f"{function.name}: {parameters} parameters")
    return found


@pytest.mark.parametrize("file", FILES)
def test_functions_are_short(file: str) -> None:
    assert too_long((ROOT / file).read_text(encoding="utf-8")) == []


def test_what_is_too_long_is_told() -> None:
    body = "    pass\n" * 60
    assert too_long(f"def short(a, b):\n{body[:-9]}") == []
    assert too_long(f"def long(a):\n{body}") == ["long: 61 lines"]
    assert too_long("class A:\n    def of(self, a, b, c, d, e, f, g, h): ...\n") == []
    assert too_long("def wide(a, b, /, c, d, *, e, f, g, h, i): ...") == ["wide: 9 parameters"]
