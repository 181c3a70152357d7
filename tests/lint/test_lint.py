"""The rules of the source checks find what they are for."""

from dataclasses import dataclass

import pytest

from tests.lint.__main__ import violations


def documented(parameters: str) -> str:
    lines = ["Do.", "", "Parameters", "----------", *parameters.split("|")]
    return "def f(a, b, c):\n    " + repr("\n".join(lines)) + "\n"


@dataclass(frozen=True)
class Source:
    """A source file and the lines that violate a rule."""

    name: str
    file: str
    text: str
    lines: tuple[int, ...] = ()


SOURCES = [
    Source("constants", "recon/a.py", 'A = 2.5\nB = 3\n"""Why."""\nC, D = 1, 2  # why\nE = "text"\nF = (1,)\n', (1, 6)),
    Source("bare numbers", "recon/hull/a.py", "def f(x):\n    y = 0.37 * x  # why\n    return 0.37 * y + 2.0 * 1e-9\n", (3,)),
    Source("61 lines", "rig/a.py", "def f(a):\n" + 60 * "    pass\n", (1,)),
    Source("9 parameters", "rhizotwin/viewer/a.py", "def f(a, b, /, c, d, *, e, f, g, h, i): ...\n", (1,)),
    Source("no shape", "rig/a.py", "def a(x: Array) -> Array:\n    'Double.'\ndef b(x: Array) -> Array:\n    'Double (N,).'\n", (1,)),
    Source("no sections", "rig/a.py", "def c(x: int, y: int, z: int) -> tuple[int, int]:\n    'Add.'\n", (1, 1)),
    Source("dialect", "recon/a.py", 'A = "told"\n"""Nobody tells."""\ndef g(warn):\n    """Tell it."""\n    warn("hangs on")\n', (2, 4, 5)),
    Source("dialect in a folder that is not rewritten yet", "rhizotwin/a.py", '"""What roots tell."""\n'),
    Source("meaning in the place of the type", "rig/a.py", documented("a : (N,) where it is. Then.|b|    What.|c : int|    How."), (1, 1)),
    Source("name of 61 characters", "tests/a.py", f"class A:\n    def test_{56 * 'a'}(self): ...\n", (2,)),
    Source("empty loops", "tests/a.py", "for a in b:\n    pass\nwhile a:\n    ...\nfor a in b:\n    c()\n", (1, 3)),
    Source("assertions in loops", "tests/a.py", "def test_a(b):\n    while b:\n        for a in b:\n            assert a\n", (1,)),
    Source("raises in a loop", "tests/a.py", "def test_a(b):\n    for a in b:\n        with pytest.raises(A):\n            a()\n", (1,)),
    Source("assertion beside a loop", "tests/a.py", "def test_a(b):\n    assert b\n    for a in b:\n        assert a\n"),
    Source("assertions of a helper", "tests/a.py", "def f(b):\n    for a in b:\n        assert a\ndef test_a(b):\n    f(b)\n"),
]


@pytest.mark.parametrize("source", SOURCES, ids=lambda source: source.name)
def test_violations_are_found(source: Source) -> None:
    found = violations(source.file, source.text)
    assert [int(line.split(":")[1]) for line in found] == list(source.lines), found
