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
    Source("constants elsewhere", "rig/a.py", "A = 2.5\n"),
    Source("bare numbers", "recon/hull/a.py", "def f(x):\n    y = 0.37 * x  # why\n    return 0.37 * y + 2.0 * 1e-9\n", (3,)),
    Source("numbers of a layout", "rhizotwin/report/a.py", "def f(x):\n    return 0.37 * x\n"),
    Source("60 lines", "rig/a.py", "def f(a):\n" + 59 * "    pass\n"),
    Source("61 lines", "rig/a.py", "def f(a):\n" + 60 * "    pass\n", (1,)),
    Source("8 parameters", "rhizotwin/viewer/a.py", "class A:\n    def f(self, a, b, c, d, e, f, g, h): ...\n"),
    Source("9 parameters", "rhizotwin/viewer/a.py", "def f(a, b, /, c, d, *, e, f, g, h, i): ...\n", (1,)),
    Source(
        "no shape", "rig/a.py", "def a(x: Array) -> Array:\n    'Double numbers.'\ndef b(x: Array) -> Array:\n    'Double (N,).'\n", (1,)
    ),
    Source("no sections", "rig/a.py", "def c(x: int, y: int, z: int) -> tuple[int, int]:\n    'Add.'\n", (1, 1)),
    Source("sections not needed", "recon/a.py", "def c(x: int, y: int, z: int) -> tuple[int, int]:\n    'Add.'\n"),
    Source("numpydoc", "rig/a.py", documented("a : int|    How.|*b, c : (N,) array|    What.")),
    Source(
        "dialect in docstrings",
        "recon/a.py",
        '"""What roots hang on."""\nA = "told"\n"""Nobody tells."""\ndef f():\n    """Tell it."""\n',
        (1, 3, 5),
    ),
    Source(
        "dialect in messages",
        "recon/a.py",
        'def f():\n    raise ValueError(f"{f} is told")\ndef g(warn):\n    warn("hangs on")\n',
        (2, 4),
    ),
    Source("dialect in a folder that is not rewritten yet", "rhizotwin/a.py", '"""What roots tell."""\n'),
    Source("dialect in values", "recon/a.py", 'A = "told"\nB = dict(a="untold")\n'),
    Source("meaning in the place of the type", "rig/a.py", documented("a : (N,) where it is. Then.|b|    What.|c : int|    How."), (1, 1)),
    Source("name of 60 characters", "tests/a.py", f"def test_{55 * 'a'}(): ...\n"),
    Source("name of 61 characters", "tests/a.py", f"class A:\n    def test_{56 * 'a'}(self): ...\n", (2,)),
    Source("long name of a helper", "tests/a.py", f"def help_{56 * 'a'}(): ...\n"),
    Source("empty loops", "tests/a.py", "for a in b:\n    pass\nwhile a:\n    ...\nfor a in b:\n    c()\n", (1, 3)),
    Source(
        "assertions in loops", "tests/a.py", "def test_a(b):\n    while b:\n        c()\n        for a in b:\n            assert a\n", (1,)
    ),
    Source("raises in a loop", "tests/a.py", "def test_a(b):\n    for a in b:\n        with pytest.raises(A):\n            a()\n", (1,)),
    Source("warns in a loop", "tests/a.py", "def test_a(b):\n    for a in b:\n        with c, pytest.warns(A):\n            a()\n", (1,)),
    Source("assertion beside a loop", "tests/a.py", "def test_a(b):\n    assert b\n    for a in b:\n        assert a\n"),
    Source("assertion after a loop", "tests/a.py", "def test_a(b):\n    for a in b:\n        c()\n    else:\n        assert a\n"),
    Source("loop within raises", "tests/a.py", "def test_a(b):\n    with pytest.raises(A):\n        for a in b:\n            assert a\n"),
    Source("assertions of a helper", "tests/a.py", "def f(b):\n    for a in b:\n        assert a\ndef test_a(b):\n    f(b)\n"),
    Source("other rules in tests", "tests/a.py", "def f(a):\n" + 60 * "    pass\n"),
]


@pytest.mark.parametrize("source", SOURCES, ids=lambda source: source.name)
def test_violations_are_found(source: Source) -> None:
    found = violations(source.file, source.text)
    assert [int(line.split(":")[1]) for line in found] == list(source.lines), found
