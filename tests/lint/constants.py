"""Each constant of the reconstruction and of its score states its reason."""

import ast
from collections.abc import Iterator

PLAIN = {0.0, 0.25, 0.5, 0.75, 0.95, 0.98, 0.99, 0.999, 1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 9.0, 12.0, 95.0, 100.0, 180.0, 255.0, 360.0}
"""Numbers of formulae, percentages, angles and 8-bit levels."""
GUARD = 1e-3
"""Smaller numbers keep a divisor from zero; numbers above the inverse are sizes in bits or pixels."""


def check(file: str, tree: ast.Module, lines: list[str]) -> Iterator[tuple[int, str]]:
    """Yield line and message of each unexplained number of a module of `recon` or `rhizotwin.scoring`."""
    if file.startswith(("recon/", "rhizotwin/scoring/")):
        yield from unexplained(tree, lines)
        # settings have a docstring for each field
        if file.count("/") > 1:
            yield from bare(tree, lines)


def unexplained(tree: ast.Module, lines: list[str]) -> Iterator[tuple[int, str]]:
    """Yield module constants that hold a number and have neither a docstring below nor a comment beside them."""
    for node, below in zip(tree.body, [*tree.body[1:], None], strict=True):
        if not isinstance(node, ast.Assign | ast.AnnAssign) or node.value is None:
            continue
        target = node.targets[0] if isinstance(node, ast.Assign) else node.target
        name = next(part.id for part in ast.walk(target) if isinstance(part, ast.Name))
        number = any(isinstance(part, ast.Constant) and type(part.value) in (int, float) for part in ast.walk(node.value))
        documented = isinstance(below, ast.Expr) and isinstance(below.value, ast.Constant) and isinstance(below.value.value, str)
        if number and name.isupper() and not documented and "#" not in lines[node.lineno - 1]:
            yield node.lineno, f"{name} has no reason below or beside it"


def bare(tree: ast.Module, lines: list[str]) -> Iterator[tuple[int, str]]:
    """Yield fractions in functions that are neither named, nor part of a formula, nor explained beside them."""
    for function in ast.walk(tree):
        for part in ast.walk(function) if isinstance(function, ast.FunctionDef) else ():
            if isinstance(part, ast.Constant) and type(part.value) is float:
                known = part.value in PLAIN or abs(part.value) <= GUARD or part.value >= 1.0 / GUARD
                if not known and "#" not in lines[part.lineno - 1]:
                    yield part.lineno, f"{part.value} is a bare number"
