"""Every constant of the reconstruction says why it is what it is."""

import ast
from pathlib import Path

import pytest

RECON = Path(__file__).resolve().parents[2] / "recon"
FILES = sorted(str(path.relative_to(RECON)) for path in RECON.rglob("*.py"))
PLAIN = {
    0.0,
    0.25,
    0.5,
    0.75,
    0.95,
    0.98,
    0.99,
    0.999,
    1.0,
    1.5,
    2.0,
    3.0,
    4.0,
    5.0,
    6.0,
    8.0,
    9.0,
    12.0,
    95.0,
    100.0,
    180.0,
    255.0,
    360.0,
    1024.0,
    65535.0,
}
"""Numbers of formulae, percentages, angles, bits and guards."""
GUARD = 1e-3
"""What is no larger keeps a divisor from zero."""
NAMED = ("calibration", "coverage", "hull", "optics", "roots", "scoring", "shoots", "tubes", "uncertainty")
"""Packages in which functions hold no bare number; in `results` figures are laid out."""


def has_number(node: ast.AST) -> bool:
    """Tell whether an expression holds a number."""
    return any(isinstance(part, ast.Constant) and type(part.value) in (int, float) for part in ast.walk(node))


def unexplained(source: str) -> list[str]:
    """Return the module's constants that hold a number, and neither a docstring below nor a comment beside them."""
    body, lines = ast.parse(source).body, source.splitlines()
    found = []
    for place, node in enumerate(body):
        if not isinstance(node, ast.Assign | ast.AnnAssign) or node.value is None or not has_number(node.value):
            continue
        target = node.targets[0] if isinstance(node, ast.Assign) else node.target
        name = next(part.id for part in ast.walk(target) if isinstance(part, ast.Name))
        below = body[place + 1] if place + 1 < len(body) else None
        told = isinstance(below, ast.Expr) and isinstance(below.value, ast.Constant) and isinstance(below.value.value, str)
        if name.isupper() and not told and "#" not in lines[node.lineno - 1]:
            found.append(name)
    return found


def bare(source: str) -> list[str]:
    """Return the fractions in functions that are neither named, nor of a formula, nor explained beside them."""
    tree, lines = ast.parse(source), source.splitlines()
    found = []
    for function in ast.walk(tree):
        for part in ast.walk(function) if isinstance(function, ast.FunctionDef) else ():
            if isinstance(part, ast.Constant) and type(part.value) is float:
                known = part.value in PLAIN or abs(part.value) <= GUARD or part.value >= 1.0 / GUARD
                if not known and "#" not in lines[part.lineno - 1]:
                    found.append(f"line {part.lineno}: {part.value}")
    return found


@pytest.mark.parametrize("file", FILES)
def test_a_constant_has_its_reason_beside_it(file: str) -> None:
    assert unexplained((RECON / file).read_text(encoding="utf-8")) == []


@pytest.mark.parametrize("file", [file for file in FILES if file.startswith(NAMED)])
def test_a_function_holds_no_bare_number(file: str) -> None:
    assert bare((RECON / file).read_text(encoding="utf-8")) == []


def test_the_audit_finds_what_it_looks_for() -> None:
    assert unexplained('A = 2.5\nB = 3\n"""Why."""\nC, D = 1, 2  # why\nE = "text"\nF = (1,)\n') == ["A", "F"]
    assert bare("def f(x):\n    y = 0.37 * x  # why\n    return 0.37 * y + 2.0 * 1e-9\n") == ["line 3: 0.37"]
