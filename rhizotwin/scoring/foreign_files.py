"""Read the output files of other methods: meshes, voxels, points and tables of traits."""

import json
import math
import struct
import zipfile
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import nrrd
import numpy as np
import trimesh
from numpy.typing import NDArray

from rhizotwin.recon.results.parts import Leaves, Mesh
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.formatting import printable
from rhizotwin.scenes.reading import check_size
from rhizotwin.scenes.table_file import number, read_table
from rhizotwin.scenes.trait_table import DEFINITIONS
from rhizotwin.stored import result_files

Floats = NDArray[np.float64]

MESHES = (".ply", ".stl", ".obj", ".glb")
"""File name extensions of triangle meshes."""
VOXELS = (".nrrd", ".npz")
"""File name extensions of voxel arrays."""
POINTS = (".ply", ".xyz")
"""File name extensions of point sets."""
_COMPRESSIONS = {
    "KHR_draco_mesh_compression": "Draco",
    "EXT_meshopt_compression": "meshopt",
    "KHR_meshopt_compression": "meshopt",
    "KHR_mesh_quantization": "quantised coordinates",
    "KHR_texture_basisu": "KTX textures",
}
"""Extensions of glTF under the names that programs show."""
MOST_MIB = 1024
"""Maximum size of a file of voxels or points, MiB."""
MOST_OCCUPIED = 50_000_000
"""Maximum number of occupied voxels. A solid of 50 ml consists of this number of voxels with an edge of 0.1 mm."""
_UNITS_MM = {"": 1.0, "mm": 1.0, "millimeter": 1.0, "millimetre": 1.0, "cm": 10.0, "m": 1000.0, "um": 0.001, "\N{MICRO SIGN}m": 0.001}
"""Units of length in NRRD files, mm."""
_UNREADABLE = (nrrd.NRRDError, KeyError, IndexError, ValueError, TypeError, OSError, EOFError, MemoryError, zipfile.BadZipFile, zlib.error)
"""Exceptions that NumPy, pynrrd and zlib raise if a file is damaged."""


@dataclass(frozen=True, kw_only=True)
class Stated:
    """Value of a trait as reported by another method."""

    value: float
    """Value that the method reports, in the unit of the trait."""
    interval: tuple[float, float] | None = None
    """90 % interval that the method reports. It is None if the method reports no interval."""


def read_shape(path: Path) -> Mesh:
    """Read a triangle mesh from a PLY, STL, OBJ or GLB file.

    PLY, STL and OBJ files are in mm with z up. GLB files are in metres with y up, as required by the standard.

    Raises
    ------
    UserError
        If the file is missing or damaged, has no faces, or has an unsupported format.
    """
    if path.suffix.lower() not in MESHES:
        raise UserError(f"{path} has no supported mesh format; the format must be one of: {', '.join(MESHES)}")
    if path.suffix.lower() == ".glb" and path.is_file():
        _check_glb(path)
    read = result_files.read_mesh(path)
    merged = trimesh.Trimesh(read.vertices_mm, read.faces, process=False)
    merged.merge_vertices()  # triangles in an STL file have separate vertices
    mesh = Mesh.of(merged)
    if path.suffix.lower() != ".glb":
        return mesh
    x, y, z = 1000.0 * mesh.vertices_mm.T
    return Mesh(vertices_mm=np.stack([x, -z, y], axis=1), faces=mesh.faces)


def read_voxels(path: Path) -> tuple[Leaves, tuple[int, int, int]]:
    """Read the occupancies of a voxel array in the canister frame.

    An NRRD file states the centre of the first voxel (``space origin`` or ``axis mins``) and cubic voxels along x, y
    and z (``space directions`` or ``spacings``), in any order and direction of the axes, mm or another ``space units``.
    An NPZ file contains the arrays ``occupancy`` (X, Y, Z), ``origin_mm`` (3,), which is the lowest corner of the first
    voxel, and ``voxel_mm``. Booleans and floats from 0 to 1 are fractions. Arrays with 0 and one other value are masks.
    Other integers are divided by 255, 65535 or the maximum of their type.

    Returns
    -------
    leaves, shape : Leaves, tuple of int
        Occupied voxels, and number of voxels of the array along x, y and z.

    Raises
    ------
    UserError
        If the file is missing or damaged, or has an unsupported format, or its values are no occupancies.
    """
    if path.suffix.lower() not in VOXELS:
        raise UserError(f"{path} has no supported voxel format; the format must be one of: {', '.join(VOXELS)}")
    _check(path)
    try:
        block, origin_mm, voxel_mm = _read_nrrd(path) if path.suffix.lower() == ".nrrd" else _read_npz(path)
        if block.ndim != 3 or not block.size or block.dtype.kind not in "buif":
            raise ValueError(
                f"the array has the shape {block.shape} and the type {block.dtype}; it must be a numeric array with three axes"
            )
        if not (np.isfinite(origin_mm).all() and math.isfinite(voxel_mm) and voxel_mm > 0.0):
            raise ValueError("the origin must be finite, and the voxel size must be finite and positive")
        share = _to_fractions(block)
    except _UNREADABLE as error:
        missing = f"the field {error} is missing" if isinstance(error, KeyError) else str(error)
        raise UserError(f"{path} could not be read as voxels: {printable(missing)[:200]}") from None
    if (occupied := int(np.count_nonzero(share))) > MOST_OCCUPIED:
        raise UserError(f"{path}: the number of occupied voxels is {occupied}, but must be at most {MOST_OCCUPIED}; use larger voxels")
    low = np.argwhere(share).astype(np.int32)
    leaves = Leaves(
        low=low,
        size=np.ones(len(low), np.int32),
        occupancy=share[tuple(low.T)],
        origin_mm=origin_mm,
        voxel_mm=voxel_mm,
    )
    return leaves, (block.shape[0], block.shape[1], block.shape[2])


def read_points(path: Path) -> Floats:
    """Read points (N, 3), mm, from the vertices of a PLY file, or from a text file with x, y and z in each line.

    Raises
    ------
    UserError
        If the file is missing, damaged or empty, or has an unsupported format.
    """
    if path.suffix.lower() not in POINTS:
        raise UserError(f"{path} has no supported point format; the format must be one of: {', '.join(POINTS)}")
    _check(path)
    if path.suffix.lower() == ".ply":
        loaded = result_files.load_geometry(path, "points")
        points = np.asarray(getattr(loaded, "vertices", ()), np.float64).reshape(-1, 3)
    else:
        try:
            points = np.loadtxt(path, ndmin=2, usecols=(0, 1, 2), encoding="utf-8-sig")
        except (ValueError, IndexError) as error:
            raise UserError(f"{path} could not be read as points: {printable(str(error))[:200]}") from None
    if not len(points) or not np.isfinite(points).all():
        raise UserError(f"{path} contains {len(points)} points; at least one is needed, and all coordinates must be finite")
    return points


def read_traits(path: Path) -> dict[str, Stated]:
    """Read a table of traits that another method measured.

    The columns are ``trait`` and ``value``, and optionally ``low`` and ``high``, which are the limits of a 90 %
    interval. Traits have the names and units of ``rhizotwin traits``, and the unit may be omitted from the name. Other
    rows are ignored.

    Raises
    ------
    UserError
        If the file, the column ``trait`` or the column ``value`` is missing, or a number is invalid.
    """
    names = {column: name for one in DEFINITIONS for column, name in ((one.name, one.name), (one.column, one.name))}
    rows = read_table(path)
    if not {"trait", "value"} <= rows[0].cells.keys():
        raise UserError(f"{path}: the first line must contain the columns 'trait' and 'value' (and 'low' and 'high' for intervals)")
    found: dict[str, Stated] = {}
    for row in rows:
        name = names.get(row.cells["trait"])
        value, low, high = (number(row, column) if name else None for column in ("value", "low", "high"))
        if name and value is not None:
            found[name] = Stated(value=value, interval=None if low is None or high is None else (low, high))
    if not found:
        raise UserError(
            f"{path} contains no known trait, such as {', '.join(one.column for one in DEFINITIONS[:4])}; "
            "'rhizotwin traits' prints all names"
        )
    return found


def _check(path: Path) -> None:
    if not path.is_file():
        raise UserError(f"{path} does not exist")
    check_size(path, path.stat(), most_mib=MOST_MIB)


def _check_glb(path: Path) -> None:
    """Raise `UserError` if the triangles of a GLB file are stored in an extension of glTF, or in other files.

    The file begins with its length and that of its JSON part (glTF 2.0, section 4.4).
    """
    with path.open("rb") as file:
        magic, version, _, length, kind = struct.unpack("<4sIII4s", file.read(20).ljust(20))
        text = file.read(min(length, result_files.MOST_SHAPE_MIB * 2**20))
    try:
        content: Any = json.loads(text.decode()) if (magic, version, kind) == (b"glTF", 2, b"JSON") else None
        required = [str(name) for name in content.get("extensionsRequired", [])]
        elsewhere = [buffer["uri"] for buffer in content.get("buffers", []) if not buffer.get("uri", "data:").startswith("data:")]
        sparse = any("sparse" in accessor for accessor in content.get("accessors", []))
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
        raise UserError(f"{path} is damaged or no GLB file (binary glTF 2.0); export the mesh again") from None
    if required:
        names = ", ".join(f"{name} ({_COMPRESSIONS[name]})" if name in _COMPRESSIONS else name for name in required)
        raise UserError(
            f"{path} requires the glTF extension {printable(names)[:200]}, which is not supported; export it without compression"
        )
    if elsewhere or sparse:
        raise UserError(f"{path} has its triangles in other files or in sparse accessors; export it as one GLB file without them")


def _read_nrrd(path: Path) -> tuple[NDArray[np.generic], Floats, float]:
    with path.open("rb") as file:
        if file.read(4) != b"NRRD":
            raise ValueError("the file is empty or no NRRD file")
        file.seek(0)
        header = nrrd.read_header(file)
        encoding = header["encoding"]
        if {"data file", "datafile"} & set(header) or encoding not in ("raw", "gzip", "gz"):
            raise ValueError("the voxels must be stored in the same file with the encoding raw or gzip")
        most = result_files.MOST_SHAPE_MIB * 2**20
        if math.prod(int(size) for size in header["sizes"]) > most:
            raise ValueError(f"the array of size {header['sizes']} is too large; use larger voxels")
        if encoding != "raw":
            unpacked = zlib.decompressobj(zlib.MAX_WBITS | 32)
            unpacked.decompress(file.read(), most)
            if unpacked.unconsumed_tail:
                raise ValueError(f"the unpacked size exceeds {result_files.MOST_SHAPE_MIB} MiB")
    unit = {str(unit).strip('" ') for unit in header.get("space units", header.get("units", ["mm"]))}
    if len(unit) > 1 or not unit <= _UNITS_MM.keys():
        raise ValueError(f"the unit is {', '.join(sorted(unit))}, but must be mm, cm, m or um")
    unit_mm = _UNITS_MM[unit.pop()]
    directions = unit_mm * np.asarray(
        header["space directions"] if "space directions" in header else np.diag(header["spacings"]), np.float64
    )
    voxel_mm = float(np.abs(directions[0]).max())
    along = np.round(directions / voxel_mm)
    if (
        directions.shape != (3, 3)
        or not np.allclose(directions, voxel_mm * along, atol=1e-6 * voxel_mm)
        or abs(np.linalg.det(along)) != 1.0
    ):
        raise ValueError("the voxels must be cubes aligned with x, y and z")
    if "space origin" not in header and "axis mins" not in header:
        raise ValueError("the position is missing; state the centre of the first voxel as 'space origin'")
    first_mm = unit_mm * np.asarray(header["space origin"] if "space origin" in header else header["axis mins"], np.float64)
    if "space origin" not in header and "cell" in header.get("centerings", ()):
        first_mm = first_mm + 0.5 * voxel_mm
    block = nrrd.read(str(path), index_order="F")[0]
    last_mm = first_mm + along.T @ (voxel_mm * (np.array(block.shape) - 1.0))
    ahead = along.sum(axis=1)
    block = block[tuple(slice(None, None, int(sign)) for sign in ahead)].transpose(np.argmax(np.abs(along), axis=0))
    return block, np.minimum(first_mm, last_mm) - 0.5 * voxel_mm, voxel_mm


def _read_npz(path: Path) -> tuple[NDArray[np.generic], Floats, float]:
    with path.open("rb") as file, np.load(file, allow_pickle=False) as stored:
        if not isinstance(stored, np.lib.npyio.NpzFile) or stored.zip is None:
            raise ValueError("the file must contain an archive of named arrays, not a single array")
        result_files.check_unpacked(path, stored.zip.infolist())
        return stored["occupancy"], np.asarray(stored["origin_mm"], np.float64).reshape(3), float(stored["voxel_mm"])


def _to_fractions(block: NDArray[np.generic]) -> NDArray[np.float32]:
    """Convert the values of an array to occupancies from 0 to 1.

    Raise `ValueError` if they are neither fractions nor a mask nor levels of grey.
    """
    share = np.asarray(block, np.float32)
    low, high = float(share.min()), float(share.max())
    if not (math.isfinite(high) and low >= 0.0):
        raise ValueError(f"the values are {low:g} to {high:g}; occupancies must be between 0 and 1")
    if high <= 1.0:
        return share
    if bool(((share == 0.0) | (share == high)).all()):
        return share / np.float32(high)
    if block.dtype.kind in "ui":
        full = float(np.iinfo(block.dtype.name).max)
        if block.dtype.kind == "u" and high > full / 8.0:
            return share / np.float32(full)
        if high in (255.0, 65535.0, full):
            return share / np.float32(high)
    raise ValueError(f"occupancies must be between 0 and 1, but the largest value is {high:g}; export fractions instead of labels")
