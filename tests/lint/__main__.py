"""Check the sources by the rules of this project that ruff does not have: ``python -m tests.lint``.

Each violation is one line, ``file:line: message``; the exit code is 1 where there is one.
"""

import ast
import sys
from collections.abc import Iterator
from pathlib import Path

from tests.lint import cases, constants, dialect, docstrings, ladder_age, lengths

ROOT = Path(__file__).resolve().parents[2]
RULES = (constants, dialect, docstrings, lengths)
TEST_RULES = (cases,)
FOLDERS = ("benchmarks", "recon", "rhizotwin", "rig", "scenes", "sim", "tests")


def sources() -> Iterator[Path]:
    """Yield every source file; `rhizotwin` holds links to the other folders, which are not followed."""
    for folder in FOLDERS:
        yield from sorted(path for path in (ROOT / folder).rglob("*.py") if path.resolve() == path)


def violations(file: str, source: str) -> list[str]:
    """Return the violations of one source file, named relative to the repository."""
    tree, lines = ast.parse(source), source.splitlines()
    rules = TEST_RULES if file.startswith("tests/") else RULES
    return [f"{file}:{line}: {message}" for rule in rules for line, message in rule.check(file, tree, lines)]


def main() -> int:
    """Print the violations of all source files, and of the ladder."""
    found = [line for path in sources() for line in violations(path.relative_to(ROOT).as_posix(), path.read_text(encoding="utf-8"))]
    found += ladder_age.check(ROOT)
    sys.stdout.writelines(f"{line}\n" for line in found)
    return bool(found)


if __name__ == "__main__":
    sys.exit(main())
