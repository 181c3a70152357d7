"""Digests that detect changes of what results depend on: code, calibration of the intervals, and files of specimens.

An entry point depends on the code of all modules of this project that it imports, directly or indirectly. They are
found by parsing the source files.
"""

import ast
import hashlib
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path

from rhizotwin.recon.uncertainty import calibration
from rhizotwin.scenes.dataset import file_sha256
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.specimens import MeshSpecimen, RsmlSpecimen

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = (
    "rhizotwin.scenes",
    "rhizotwin.sim",
    "rhizotwin.recon",
    "rhizotwin.scoring",
    "rhizotwin.stored",
    "benchmarks",
)
"""Packages whose modules are included in a digest. Other libraries are represented in it by their version numbers."""

DATA_OF_SCENES = ("rhizotwin/scenes/library", "rhizotwin/scenes/profiles")
"""Data folders that are not included in digests. Their contents are recorded in the settings of each picture
instead."""

_Import = tuple[int, str, tuple[str, ...]]
"""Import statement: level of a relative import, name of the module, and imported names. The level is 0 for an absolute
import."""


def closure(entries: Iterable[str], *, root: Path = ROOT, without: frozenset[str] = frozenset()) -> list[str]:
    """Return the sorted names of the entry modules and of all project modules that they import directly or indirectly.

    Imports inside functions are included. Modules in ``without`` are excluded, and their imports are not followed.

    Raises
    ------
    FileNotFoundError
        If an entry is not a module of the project.
    """
    waiting = list(entries)
    for entry in waiting:
        if _file(entry, root) is None:
            raise FileNotFoundError(f"{entry} is not a module in {root}")
    modules: set[str] = set()
    while waiting:
        name = waiting.pop()
        file = _file(name, root)
        if name in modules or name in without or file is None:
            continue
        modules.add(name)
        waiting += [name.rpartition(".")[0]] if "." in name else []
        waiting += _imported(name, _read(file.read_bytes())[1])
    return sorted(modules)


def digest(entries: Iterable[str], *, root: Path = ROOT, without: frozenset[str] = frozenset()) -> str:
    """Return a SHA-256 of the code of all modules in a closure, and of the data files in their packages.

    Comments and docstrings are ignored. JSON files are ignored too, because the calibration of the intervals is
    measured with this code; for results, use `digest_of_results`. The parameters are those of `closure`.
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


def digest_of_results(entries: Iterable[str]) -> str:
    """Return a digest of the code that computes results and of the calibration of their intervals.

    Parameters
    ----------
    entries : iterable of str
        Names of the modules that compute the results, see `closure`.

    Raises
    ------
    FileNotFoundError
        If an entry is not a module of the project.
    """
    return f"{digest(entries)}-{file_sha256(calibration.TABLE)}"


def specimen_hashes(scene: Scene) -> list[str]:
    """Return the SHA-256 of the file of each specimen, or an empty text if there is no such file.

    The error is reported later, when the scene is rendered.
    """
    given = [scene.specimen, *(plant.specimen for plant in scene.plants)]
    paths = [Path(specimen.file) for specimen in given if isinstance(specimen, MeshSpecimen | RsmlSpecimen)]
    return [file_sha256(path) if path.is_file() else "" for path in paths]


def _file(module: str, root: Path) -> Path | None:
    """Return the source file of a module.

    The result is None if the name is not that of a module of this project.
    """
    if not _package(module):
        return None
    place = root.joinpath(*module.split("."))
    return next((file for file in (place.with_suffix(".py"), place / "__init__.py") if file.is_file()), None)


def _package(module: str) -> str:
    """Return the package of this project that contains a module.

    The result is empty for other modules.
    """
    return next((package for package in PACKAGES if module == package or module.startswith(f"{package}.")), "")


def _imported(importer: str, imports: Iterable[_Import]) -> Iterator[str]:
    """Yield the full names that a module imports.

    ``from a import b`` yields both a and a.b, because b may be a module or a name in a.
    """
    for level, base, names in imports:
        above = [*importer.split(".")[:-level]] if level else []
        full = ".".join([*above, *([base] if base else [])])
        yield full
        yield from (f"{full}.{name}" for name in names)


@cache
def _read(source: bytes) -> tuple[str, tuple[_Import, ...]]:
    """Return the code of a module and its import statements.

    Comments, layout and docstrings are removed from the code.
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
