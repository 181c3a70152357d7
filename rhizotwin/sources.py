"""Which of our source files decide something.

The modules that an entry point imports, and theirs, read from the sources themselves.
"""

import ast
import hashlib
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = (
    "rhizotwin.scenes",
    "rhizotwin.sim",
    "rhizotwin.recon",
    "rhizotwin.baselines",
    "rhizotwin.scoring",
    "rhizotwin.stored",
    "benchmarks",
)
"""Packages whose modules count; libraries count by their versions."""

DATA_OF_SCENES = ("rhizotwin/scenes/library", "rhizotwin/scenes/profiles")
"""What these hold is in the settings of every picture already."""

_Import = tuple[int, str, tuple[str, ...]]
"""Level of a relative import (0: absolute), the module, the names from it."""


def closure(entries: Iterable[str], *, root: Path = ROOT, without: frozenset[str] = frozenset()) -> list[str]:
    """Return the names of all modules of ours that the entries import, sorted, the entries included.

    Directly or through others.

    Imports anywhere in a file count, in functions too. Modules ``without`` neither count nor are followed.

    Raises
    ------
    FileNotFoundError
        Where an entry is no module, so that nobody could tell whether it changed.
    """
    waiting = list(entries)
    for entry in waiting:
        if _file(entry, root) is None:
            raise FileNotFoundError(f"{entry} is no module in {root}")
    found: set[str] = set()
    while waiting:
        name = waiting.pop()
        file = _file(name, root)
        if name in found or name in without or file is None:
            continue
        found.add(name)
        waiting += [name.rpartition(".")[0]] if "." in name else []
        waiting += _imported(name, _read(file.read_bytes())[1])
    return sorted(found)


def digest(entries: Iterable[str], *, root: Path = ROOT, without: frozenset[str] = frozenset()) -> str:
    """Return one SHA-256 over the code of a closure and over the data files of its packages.

    Comments and docstrings are left out.
    """
    total = hashlib.sha256()
    modules = closure(entries, root=root, without=without)
    for name, file in ((name, _file(name, root)) for name in modules):
        if file is not None:
            total.update(f"{name}\0{_read(file.read_bytes())[0]}\0".encode())
    for package in sorted({_package(name) for name in modules} - {""}):
        for path in sorted(root.joinpath(*package.split("."), "").rglob("*")):
            place = path.relative_to(root).as_posix()
            if path.is_file() and path.suffix not in (".py", ".pyc", ".json") and not place.startswith(DATA_OF_SCENES):
                total.update(f"{place}\0".encode() + path.read_bytes())
    return total.hexdigest()


def _file(module: str, root: Path) -> Path | None:
    """Return a module's file; None where it is none of ours (a name inside a module, a library)."""
    if not _package(module):
        return None
    place = root.joinpath(*module.split("."))
    return next((file for file in (place.with_suffix(".py"), place / "__init__.py") if file.is_file()), None)


def _package(module: str) -> str:
    """Return which of our packages a module lies in; nothing where in none."""
    return next((package for package in PACKAGES if module == package or module.startswith(f"{package}.")), "")


def _imported(importer: str, imports: Iterable[_Import]) -> Iterator[str]:
    """Return the names that a module imports.

    ``from a import b`` gives both a and a.b, of which one may be no module.
    """
    for level, base, names in imports:
        above = [*importer.split(".")[:-level]] if level else []
        full = ".".join([*above, *([base] if base else [])])
        yield full
        yield from (f"{full}.{name}" for name in names)


@cache
def _read(source: bytes) -> tuple[str, tuple[_Import, ...]]:
    """Return a module's code without comments, layout and docstrings, and its imports.

    These cannot change what it does.
    """
    tree = ast.parse(source)
    imports: list[_Import] = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            node.body = [line for line in node.body if not _is_text(line)] or [ast.Pass()]
        elif isinstance(node, ast.Import):
            imports += [(0, alias.name, ()) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            imports.append((node.level, node.module or "", tuple(alias.name for alias in node.names)))
    return ast.unparse(tree), tuple(imports)


def _is_text(line: ast.stmt) -> bool:
    return isinstance(line, ast.Expr) and isinstance(line.value, ast.Constant) and isinstance(line.value.value, str)
