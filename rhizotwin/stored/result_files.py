"""Read the files of a result folder (listed in `recon.results.result`)."""

import json
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.results.parts import SCHEMA_VERSION, Json, Leaves, Mesh
from rhizotwin.scenes.dataset import Dataset, load_dataset
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.folders import check_readable
from rhizotwin.scenes.formatting import printable
from rhizotwin.scenes.model import MarkerStrip
from rhizotwin.scenes.picture_codec import decode_grey
from rhizotwin.scenes.reading import MOST_PICTURE_MIB, check_size, read_file
from rhizotwin.scenes.rsml import Root
from rhizotwin.scenes.rsml_reader import read_rsml
from rhizotwin.scenes.schema import Place, from_plain
from rhizotwin.stored import plain_ply, summary_checks

if TYPE_CHECKING:
    from rhizotwin.scenes.neighbours import Neighbours

MOST_SHAPE_MIB = 512
"""Maximum size, MiB, of an unpacked shape (40 bytes per leaf, including the hull) and of a surface file (25 bytes per
triangle). A shape of this size has 13 million leaves and needs 2 GiB of memory."""
RESULT_NAMES = (
    *("result.json", "shape.npz", "shape.ply", "shoot.ply", "roots.rsml", "roots.csv", "leaves.csv", "traits.csv", "traits.json"),
    *("silhouettes", "seen", "pictures", "report.html", "score.json", "corrected.json", "stages", "verify"),
)
"""Names of the files and folders that a new result may replace in an existing result folder. A folder with a log of
corrections (``edits.json``) is not replaced."""


def read_summary(folder: Path) -> Json:
    """Read ``result.json`` of a result folder.

    Raise `UserError` if the file is missing, damaged or of an unsupported version.
    """
    path = Path(folder) / "result.json"
    if not path.is_file():
        check_readable(Path(folder), deep=False)
        raise UserError(f"{path} does not exist; specify a folder written by 'rhizotwin reconstruct DATASET -o RESULT'.")
    check_readable(Path(folder))
    try:
        summary = json.loads(read_file(path).decode())
    except (ValueError, RecursionError) as error:
        raise UserError(f"{path} could not be read as JSON ({error}); repeat the reconstruction.") from None
    if not isinstance(summary, dict) or summary.get("schema_version") != SCHEMA_VERSION:
        version = summary.get("schema_version") if isinstance(summary, dict) else None
        raise UserError(
            f"{path} has the format version (schema_version) {version!r}, but must have {SCHEMA_VERSION}; repeat the reconstruction."
        )
    if fault := summary_checks.find_fault(summary):
        raise UserError(f"{path} {fault}; repeat the reconstruction.")
    return summary


def results_in(folders: Sequence[Path]) -> list[Path]:
    """Return all results among some folders and their subfolders, for example the results of a batch.

    Raises
    ------
    UserError
        If a folder contains no result. Paths that are not folders are returned unchecked.
    """
    found: list[Path] = []
    for folder in folders:
        inside = [folder]
        if folder.is_dir() and not (folder / "result.json").is_file():
            check_readable(folder, deep=False)
            inside = sorted(path.parent for path in folder.glob("[!.]*/result.json"))
        if not inside:
            raise UserError(f"{folder} contains no result.json; specify a folder written by 'rhizotwin reconstruct' or 'rhizotwin batch'.")
        found += inside
    return found


def read_shape_picture(folder: Path) -> NDArray[np.uint8] | None:
    """Read the figure of a result's shape (H, W, 3), BGR. Return None if the figure is missing or cannot be decoded."""
    import cv2  # loaded on first use

    file = folder / "pictures" / "shape.png"
    data = np.frombuffer(read_file(file, most_mib=MOST_PICTURE_MIB) if file.is_file() else b"", np.uint8)
    # decoded from memory, because OpenCV terminates the process if a file name is not UTF-8
    image = cv2.imdecode(data, cv2.IMREAD_COLOR) if len(data) else None
    return None if image is None else image.astype(np.uint8)


def read_strip(folder: Path, summary: Json) -> MarkerStrip | None:
    """Read the marker strip of a result.

    It is None in results of earlier versions, which do not contain it. Raise `UserError` if the entry is damaged.
    """
    strip = summary.get("strip")
    return None if strip is None else from_plain(MarkerStrip, strip, Place(str(Path(folder) / "result.json")).at("strip"))


def read_leaves(folder: Path, *, hull: bool = False) -> Leaves:
    """Read the leaves of the shape or of the untrimmed hull.

    Raise `UserError` if the file is missing, damaged or empty, or if a value is invalid.
    """
    path = Path(folder) / "shape.npz"
    prefix = "hull_" if hull else ""
    if not path.is_file():
        raise UserError(f"{path} does not exist; repeat the reconstruction.")
    try:
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as stored:
            check_unpacked(path, stored.zip.infolist())
            leaves = Leaves(
                low=stored[f"{prefix}leaves"],
                size=stored[f"{prefix}size"],
                occupancy=stored[f"{prefix}occupancy"].astype(np.float32, copy=False),
                origin_mm=stored["origin_mm"].astype(np.float64),
                voxel_mm=float(stored["voxel_mm"]),
            )
    except UserError:
        raise
    except Exception as error:  # noqa: BLE001 - a damaged archive raises zipfile, zlib, key and value errors
        raise UserError(f"{path} is damaged ({error}); repeat the reconstruction.") from None
    count = len(leaves.low)
    if leaves.low.shape != (count, 3) or leaves.size.shape != (count,) or leaves.occupancy.shape != (count,):
        shapes = f"{leaves.low.shape}, {leaves.size.shape} and {leaves.occupancy.shape}"
        raise UserError(
            f"{path} is damaged: the arrays have the shapes {shapes}, but must be (N, 3), (N,) and (N,); repeat the reconstruction."
        )
    if not count:
        raise UserError(
            f"{path} contains an empty shape, because nothing was reconstructed; check the pictures and the scene, then reconstruct again."
        )
    if fault := _find_fault(leaves):
        raise UserError(f"{path} is damaged: {fault}; repeat the reconstruction.")
    return leaves


def _find_fault(leaves: Leaves) -> str:
    """Return a description of the first invalid value of the leaves. It is empty if all values are valid."""
    origin_mm, occupancy = leaves.origin_mm, leaves.occupancy
    whole = leaves.low.dtype.kind in "iu" and leaves.size.dtype.kind in "iu"
    valid = {
        "the positions and sizes of the leaves must be integers": whole,
        "the size of every leaf must be at least 1": whole and (leaves.size >= 1).all(),
        "origin_mm must be three finite numbers": origin_mm.shape == (3,) and np.isfinite(origin_mm).all(),
        "voxel_mm must be a finite number above 0": 0.0 < leaves.voxel_mm < np.inf,
        "all occupancies must be 0 to 1": ((occupancy >= 0.0) & (occupancy <= 1.0)).all(),
    }
    return next((condition for condition, fits in valid.items() if not fits), "")


def check_unpacked(path: Path, parts: Sequence[zipfile.ZipInfo]) -> None:
    """Raise `UserError` if an archive would be too large for the memory after unpacking.

    The size is read from the archive's list of files, without unpacking.
    """
    size_mib = sum(part.file_size for part in parts) / 2**20
    if size_mib > MOST_SHAPE_MIB:
        raise UserError(f"the unpacked size of {path} is {size_mib:.0f} MiB, but must be at most {MOST_SHAPE_MIB} MiB; use larger voxels.")


def read_mesh(path: Path) -> Mesh:
    """Read vertices and faces of a mesh file. Raise `UserError` if the file is missing or damaged, or has no faces."""
    if not Path(path).is_file():
        raise UserError(f"the triangle mesh {path} does not exist; check the path.")
    check_size(path, Path(path).stat(), most_mib=MOST_SHAPE_MIB)
    plain = plain_ply.read(Path(path))
    mesh = _read_any_mesh(path) if plain is None else Mesh(vertices_mm=plain[0], faces=plain[1])
    vertices, faces = mesh.vertices_mm, mesh.faces
    if not len(faces) or not np.isfinite(vertices).all():
        raise UserError(f"{path} has {len(faces)} triangles; at least one is needed, and all coordinates must be finite.")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise UserError(
            f"{path} is damaged: triangles refer to vertices {faces.min()} to {faces.max()}, "
            f"but the file contains only {len(vertices)} vertices "
            f"(0 to {len(vertices) - 1})."
        )
    return mesh


def _read_any_mesh(path: Path) -> Mesh:
    loaded = load_geometry(path, "mesh")
    if not hasattr(loaded, "faces"):  # points only
        raise UserError(f"{path} has no triangles; export the shape as a triangle mesh.")
    return Mesh.of(loaded)


def load_geometry(path: Path, kind: Literal["mesh", "points"]) -> Any:
    """Load a mesh or points from a file in any format that trimesh supports.

    Parameters
    ----------
    path : Path
        Path of the file.
    kind : {"mesh", "points"}
        Expected content of the file.

    Raises
    ------
    UserError
        If the file is damaged or has other content.
    """
    import trimesh  # takes half a second to load

    try:
        return trimesh.load(path, process=False, force="mesh" if kind == "mesh" else None)
    except Exception as error:  # noqa: BLE001 - the parsers of trimesh raise various exceptions
        raise UserError(f"{path} could not be read as {kind} ({printable(str(error))[:200]}); export the file again.") from None


def read_roots(folder: Path) -> tuple[Root, ...]:
    """Read the roots of a result. The tuple is empty if the result is a solid without roots."""
    file = folder / "roots.rsml"
    return read_rsml(file) if file.is_file() else ()


def finest_mm(summary: Json) -> float:
    """Return the edge, mm, of the smallest voxels, from which the surface of a result was extracted."""
    return float(summary.get("settings", {}).get("finest_mm", summary["voxel_mm"]))


def read_neighbours(folder: Path) -> "tuple[Neighbours, ...]":
    """Return the distances between the plants of a result.

    The tuple is empty if the result has only one plant or no roots.
    """
    from rhizotwin.scenes.neighbours import find_neighbours  # SciPy takes half a second to load

    return find_neighbours(read_roots(folder))


def read_grey(path: Path, *, image_wh: tuple[int, int] | None = None) -> NDArray[np.float32]:
    """Read a grey picture (8 or 16 bit) as (H, W), 0 to 1.

    Raise `UserError` if it is missing, damaged or of the wrong size.
    """
    if not path.is_file():
        raise UserError(f"{path} does not exist; create its folder again.")
    picture = decode_grey(read_file(path, most_mib=MOST_PICTURE_MIB), where=str(path))
    if image_wh is not None and picture.shape != image_wh[::-1]:
        height, width = picture.shape
        raise UserError(f"{path} has {width}x{height} pixels, but the camera's pictures have {image_wh[0]}x{image_wh[1]} pixels.")
    return np.asarray(picture / np.float32(np.iinfo(picture.dtype).max), np.float32)


def find_dataset(folder: Path, summary: Json, given: Dataset | Path | None) -> Dataset | None:
    """Return the given dataset. If none is given, return the dataset recorded in the result.

    Return None if the recorded dataset no longer exists or has changed.

    Parameters
    ----------
    folder, summary : Path, Json
        Result folder, and content of its ``result.json``.
    given : Dataset, path or None
        Dataset of the result, or the dataset's folder. None: the recorded dataset.

    Raises
    ------
    UserError
        If the given dataset cannot be read, or is not that of the result.
    """
    try:
        found = given if isinstance(given, Dataset) else load_dataset(given or Path(str(summary.get("dataset", ""))))
        check_same_scan(summary["dataset_sha256"], summary["scene"], folder, found)
    except UserError:
        if given is not None:
            raise
        return None
    return found


def check_same_scan(dataset_sha256: str, scene: str, where: Path | str, dataset: Dataset) -> None:
    """Raise `UserError` if a result was not reconstructed from the present content of a dataset.

    The hash of the dataset's manifest is compared with the hash in the result.

    Parameters
    ----------
    dataset_sha256, scene : str
        Hash of the dataset and name of the scene that are recorded in the result.
    where : Path or str
        Name of the result for the error message.
    dataset : Dataset
        Dataset to compare with the result.
    """
    if dataset_sha256 != dataset.sha256:
        raise UserError(
            f"{where} was not reconstructed from the present content of {dataset.folder} (scene of the result: {scene!r}); "
            "specify the dataset of the result, or repeat the reconstruction."
        )
