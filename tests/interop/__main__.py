"""Open the exports of a small result with other programs, and compare their numbers with ours: ``./run interop``.

Every program is installed into a temporary environment of its own. The exit code is 1 if a number differs by more than
0.1 %, and 2 if all agree but a program could not be installed.
"""

import argparse
import json
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import tifffile

from rhizotwin import engine
from rhizotwin.drawing import surface_mesh
from rhizotwin.exporter import exports, mesh_files
from rhizotwin.publishing.study import EXAMPLE
from rhizotwin.stored import result_files
from tests.interop import mesh_readers, miappe_tables, ro_crate, rsml_readers
from tests.interop.environment import NotInstalledError, fetch, install, run
from tests.rhizotwin import plant

TOLERANCE = 1e-3
"""Largest relative difference; for coordinates relative to 100 mm, the size of a plant."""
NAMES = ("volume mm3", "centre x mm", "centre y mm", "centre z mm", "lowest z mm")
GLTF = """const v = require('gltf-validator'), fs = require('fs');
v.validateBytes(new Uint8Array(fs.readFileSync(process.argv[1]))).then(r => console.log(JSON.stringify([r.validatorVersion,
  r.issues.numErrors + r.issues.numWarnings, r.info.totalTriangleCount])));"""
COLMAP = """import json, sys
from pathlib import Path
sys.path.insert(0, sys.argv[1])
import colmap_models
print(json.dumps(colmap_models.check_colmap_model(Path(sys.argv[2]), Path(sys.argv[3]))))"""

Pairs = dict[str, tuple[float, float]]


@dataclass(frozen=True)
class Made:
    """Exports of a small plant, the numbers of its meshes and voxels, and the environment for one reader."""

    folder: Path
    ours: dict[str, list[float]]
    triangles: int
    environment: Path


def make(folder: Path) -> tuple[dict[str, list[float]], int]:
    """Write a dataset and a result of a small plant with all exports."""
    made = plant.make(folder)
    suffixes = (*mesh_files.SUFFIXES, ".nrrd", ".nii.gz", ".vtk", ".tif")
    for suffix in suffixes:
        exports.export(made.result, folder / f"a{suffix}")
    for name in ("colmap", "transforms.json"):
        exports.export(made.result, folder / name, dataset_folder=made.dataset)
    exports.export(made.result, folder / "roots.glb", roots="order")
    with tifffile.TiffFile(folder / "a.tif") as stack:
        (folder / "a.tif.txt").write_text(stack.pages[0].description)
    mesh = surface_mesh.close(result_files.read_mesh(made.result / "shape.ply"))
    of_mesh = mesh_readers.of_mesh(mesh.vertices_mm, mesh.faces)
    leaves = result_files.read_leaves(made.result)
    weight = leaves.occupancy.astype(np.float64) * leaves.size.astype(np.float64) ** 3
    centres = leaves.origin_mm + leaves.voxel_mm * (leaves.low + leaves.size[:, None] / 2.0)
    lowest = leaves.origin_mm[2] + leaves.voxel_mm * leaves.low[:, 2].min()
    of_voxels = [float(weight.sum() * leaves.voxel_mm**3), *map(float, weight @ centres / weight.sum()), float(lowest)]
    return {f"a{suffix}": of_mesh if suffix in mesh_files.SUFFIXES else of_voxels for suffix in suffixes}, len(mesh.faces)


def version_of(python: Path, package: str) -> str:
    return run(python, "-c", f"import importlib.metadata as m; print(m.version('{package}'))").strip()


def read_meshes(program: str) -> Callable[[Made], tuple[str, Pairs]]:
    def check(made: Made) -> tuple[str, Pairs]:
        python = install(made.environment, program, "numpy")
        found = json.loads(run(python, mesh_readers.__file__, program, made.folder).splitlines()[-1])
        return version_of(python, program), {
            f"{file}, {name}": (value, ours)
            for file, values in found.items()
            for name, value, ours in zip(NAMES, values, made.ours[file], strict=True)
        }

    return check


def read_cameras(made: Made) -> tuple[str, Pairs]:
    python = install(made.environment, "pycolmap", "numpy")
    model, transforms = made.folder / "colmap", made.folder / "transforms.json"
    pairs = json.loads(run(python, "-c", COLMAP, Path(__file__).parent, model, transforms).splitlines()[-1])
    differing = max(pairs, key=lambda name: abs(pairs[name][0] - pairs[name][1]))
    return version_of(python, "pycolmap"), {f"{differing} (of {len(pairs)} numbers)": tuple(pairs[differing])}


def validate_gltf(made: Made) -> tuple[str, Pairs]:
    made.environment.mkdir()
    fetch("npm", "install", "--silent", "gltf-validator", folder=made.environment)
    pairs: Pairs = {}
    for file in ("a.glb", "roots.glb"):
        version, faults, triangles = json.loads(run("node", "-e", GLTF, made.folder / file, folder=made.environment))
        pairs[f"{file}, errors and warnings"] = (faults, 0)
        if file == "a.glb":
            pairs[f"{file}, triangles"] = (triangles, made.triangles)
    return version, pairs


def read_rsml(made: Made) -> tuple[str, Pairs]:
    made.environment.mkdir()
    return "pinned", rsml_readers.check(made.environment)


def validate_crate(made: Made) -> tuple[str, Pairs]:
    made.environment.mkdir()
    study, published = made.environment / "study.toml", made.environment / "published"
    study.write_text(EXAMPLE, encoding="utf-8")
    words = ["export", made.folder / "dataset", made.folder / "result", "--publish", published, "--study", study]
    run(sys.executable, "-m", "rhizotwin", *words)
    accepted = ro_crate.check(published, made.environment / "roc-validator")
    return "pinned", accepted | miappe_tables.check(published, made.environment / "metaseed")


READERS: dict[str, Callable[[Made], tuple[str, Pairs]]] = {
    "pycolmap": read_cameras,
    **{program: read_meshes(program) for program in mesh_readers.PROGRAMS},
    "gltf-validator": validate_gltf,
    "cplantbox, openalea.rsml": read_rsml,
    "roc-validator, metaseed": validate_crate,
}


def agrees(name: str, theirs: float, ours: float) -> bool:
    """Return whether two numbers agree; those of coordinates may be near zero."""
    return abs(theirs - ours) <= TOLERANCE * (100.0 if " z mm" in name or "centre" in name else abs(ours))


def rows_of(reader: str, made: Made) -> Iterator[tuple[bool | None, str]]:
    try:
        version, pairs = READERS[reader](made)
    except NotInstalledError as error:
        yield None, f"{reader}: not checked, because {error}"
        return
    except (RuntimeError, AssertionError) as error:
        yield False, f"{reader}: FAILED: {error}"
        return
    for name, (theirs, ours) in pairs.items():
        ok = agrees(name, theirs, ours)
        yield ok, f"{reader} | {version} | {name} | {ours:.6g} | {theirs:.6g} | {'ok' if ok else 'DIFFERS'}"


def main() -> int:
    """Run the given or all readers, print a table, and return the exit code."""
    parser = argparse.ArgumentParser(prog="./run interop", description=__doc__)
    parser.add_argument("reader", nargs="*", help=f"one of: {', '.join(READERS)}; default: all")
    wanted: Any = parser.parse_args().reader or list(READERS)
    if unknown := set(wanted) - set(READERS):
        parser.error(f"unknown reader: {', '.join(unknown)}")
    engine.start("cpu")
    found: list[bool | None] = []
    with TemporaryDirectory() as place:
        folder = Path(place)
        ours, triangles = make(folder)
        sys.stdout.write("reader | version | number | ours | theirs |\n")
        for index, reader in enumerate(wanted):
            for ok, row in rows_of(reader, Made(folder, ours, triangles, folder / f"environment_{index}")):
                found.append(ok)
                sys.stdout.write(f"{row}\n")
                sys.stdout.flush()
    sys.stdout.write(f"{found.count(True)} agree, {found.count(False)} differ, {found.count(None)} readers not installed\n")
    return 1 if False in found else 2 if None in found else 0


if __name__ == "__main__":
    sys.exit(main())
