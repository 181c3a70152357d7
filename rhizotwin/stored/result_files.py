"""Readers of the files of a result folder (`recon.results.result` lists them)."""

import json
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.results.parts import SCHEMA_VERSION, Json, Leaves, Mesh
from rhizotwin.scenes import rsml
from rhizotwin.scenes.dataset import Dataset, load_dataset
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.folders import check_readable
from rhizotwin.scenes.formatting import printable
from rhizotwin.scenes.model import MarkerStrip
from rhizotwin.scenes.picture_codec import decode_grey
from rhizotwin.scenes.reading import MOST_PICTURE_MIB, check_size, read_file
from rhizotwin.scenes.rsml import Root
from rhizotwin.scenes.schema import Place, from_plain
from rhizotwin.stored import plain_ply, summary_checks

if TYPE_CHECKING:
    from rhizotwin.scenes.neighbours import Neighbours

MOST_SHAPE_MIB = 512
"""Largest size of an unpacked shape (40 bytes per leaf, with the hull) and of a surface (25 bytes per triangle): 13
million leaves, which need 2 GiB of memory."""
RESULT_NAMES = (
    *("result.json", "shape.npz", "shape.ply", "roots.rsml", "traits.csv", "traits.json"),
    *("silhouettes", "seen", "pictures", "report.html", "score.json", "corrected.json", "stages"),
)
"""Names that may be in a result folder that a new result replaces; a log of corrections (edits.json) may not."""


def read_summary(folder: Path) -> Json:
    """Read ``result.json`` of a result folder; UserError if it is missing, damaged or of another version."""
    path = Path(folder) / "result.json"
    if not path.is_file():
        check_readable(Path(folder), deep=False)
        raise UserError(f"{path} does not exist; give the folder that `rhizotwin reconstruct DATASET -o RESULT` wrote.")
    check_readable(Path(folder))
    try:
        summary = json.loads(read_file(path).decode())
    except (ValueError, RecursionError) as error:
        raise UserError(f"{path} is not readable JSON ({error}); reconstruct again.") from None
    if not isinstance(summary, dict) or summary.get("schema_version") != SCHEMA_VERSION:
        version = summary.get("schema_version") if isinstance(summary, dict) else None
        raise UserError(f"{path} has schema_version {version!r}, this program reads {SCHEMA_VERSION}; reconstruct again.")
    if fault := summary_checks.find_fault(summary):
        raise UserError(f"{path} {fault}; reconstruct again.")
    return summary


def results_in(folders: Sequence[Path]) -> list[Path]:
    """Return the results among folders, and those that the other folders contain, such as those of a batch.

    Raises
    ------
    UserError
        If a folder contains no result. Other paths are returned unchecked.
    """
    found: list[Path] = []
    for folder in folders:
        inside = [folder]
        if folder.is_dir() and not (folder / "result.json").is_file():
            check_readable(folder, deep=False)
            inside = sorted(path.parent for path in folder.glob("[!.]*/result.json"))
        if not inside:
            raise UserError(f"{folder}: result.json does not exist; give a folder that `rhizotwin reconstruct` or `rhizotwin batch` wrote.")
        found += inside
    return found


def read_shape_picture(folder: Path) -> NDArray[np.uint8] | None:
    """Read the figure of a result's shape, (H, W, 3) BGR; None if it is missing or cannot be decoded."""
    import cv2  # loaded on first use

    file = folder / "pictures" / "shape.png"
    data = np.frombuffer(read_file(file, most_mib=MOST_PICTURE_MIB) if file.is_file() else b"", np.uint8)
    # from bytes: OpenCV terminates the process for names that are not UTF-8
    image = cv2.imdecode(data, cv2.IMREAD_COLOR) if len(data) else None
    return None if image is None else image.astype(np.uint8)


def read_strip(folder: Path, summary: Json) -> MarkerStrip | None:
    """Read the marker strip of a result; None in results of earlier versions, UserError if it is damaged."""
    strip = summary.get("strip")
    return None if strip is None else from_plain(MarkerStrip, strip, Place(str(Path(folder) / "result.json")).at("strip"))


def read_leaves(folder: Path, *, hull: bool = False) -> Leaves:
    """Read the leaves of ``shape.npz``, or those of the untrimmed hull; UserError if missing, damaged or empty."""
    path, prefix = Path(folder) / "shape.npz", "hull_" if hull else ""
    if not path.is_file():
        raise UserError(f"{path} does not exist; reconstruct again.")
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
        raise UserError(f"{path} is damaged ({error}); reconstruct again.") from None
    count = len(leaves.low)
    if leaves.low.shape != (count, 3) or leaves.size.shape != (count,) or leaves.occupancy.shape != (count,):
        shapes = f"{leaves.low.shape}, {leaves.size.shape} and {leaves.occupancy.shape}"
        raise UserError(f"{path} has leaves, size and occupancy of shapes {shapes}, not (N, 3), (N,) and (N,); reconstruct again.")
    if not count:
        raise UserError(f"{path} has no leaves: nothing was reconstructed.")
    return leaves


def check_unpacked(path: Path, parts: Sequence[zipfile.ZipInfo]) -> None:
    """Reject an archive that is too large for the memory, before it is unpacked."""
    size_mib = sum(part.file_size for part in parts) / 2**20
    if size_mib > MOST_SHAPE_MIB:
        raise UserError(f"{path} has {size_mib:.0f} MiB when unpacked, more than {MOST_SHAPE_MIB}; use larger voxels.")


def read_mesh(path: Path) -> Mesh:
    """Read vertices and faces of a mesh file; UserError if it is missing, damaged or without faces."""
    if not Path(path).is_file():
        raise UserError(f"{path} does not exist; it should contain a triangle mesh.")
    check_size(path, Path(path).stat(), most_mib=MOST_SHAPE_MIB)
    plain = plain_ply.read(Path(path))
    mesh = _read_any_mesh(path) if plain is None else Mesh(vertices_mm=plain[0], faces=plain[1])
    vertices, faces = mesh.vertices_mm, mesh.faces
    if not len(faces) or not np.isfinite(vertices).all():
        raise UserError(f"{path} has {len(faces)} triangles and must have some, with finite vertices.")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise UserError(
            f"{path} is damaged: triangles refer to vertices {faces.min()} to {faces.max()}, but there are only {len(vertices)} "
            f"(0 to {len(vertices) - 1})."
        )
    return mesh


def _read_any_mesh(path: Path) -> Mesh:
    loaded = load_geometry(path, "mesh")
    if not hasattr(loaded, "faces"):  # points only
        raise UserError(f"{path} has no triangles and must have some.")
    return Mesh.of(loaded)


def load_geometry(path: Path, kind: Literal["mesh", "points"]) -> Any:
    """Load a mesh or points of any format that trimesh reads.

    Parameters
    ----------
    path : Path
        The file.
    kind : {"mesh", "points"}
        Expected content.

    Raises
    ------
    UserError
        If it is damaged or has other content.
    """
    import trimesh  # takes half a second to load

    try:
        return trimesh.load(path, process=False, force="mesh" if kind == "mesh" else None)
    except Exception as error:  # noqa: BLE001 - trimesh raises whatever its parsers meet
        raise UserError(f"{path} is not readable as {kind} ({printable(str(error))[:200]}).") from None


def read_roots(folder: Path) -> tuple[Root, ...]:
    """Read the roots of a result; empty for solid bodies."""
    file = folder / "roots.rsml"
    return rsml.read_rsml(file) if file.is_file() else ()


def finest_mm(summary: Json) -> float:
    """Return the edge length of the voxels from which the surface of a result was extracted."""
    return float(summary.get("settings", {}).get("finest_mm", summary["voxel_mm"]))


def read_neighbours(folder: Path) -> "tuple[Neighbours, ...]":
    """Return the distances between the plants of a result; empty for one plant or without roots."""
    from rhizotwin.scenes.neighbours import find_neighbours  # SciPy takes half a second to load

    return find_neighbours(read_roots(folder))


def read_grey(path: Path, *, image_wh: tuple[int, int] | None = None) -> NDArray[np.float32]:
    """Read a grey picture (8 or 16 bit) as (H, W), 0..1; UserError if missing, damaged or of another size."""
    if not path.is_file():
        raise UserError(f"{path} does not exist; make its folder again.")
    picture = decode_grey(read_file(path, most_mib=MOST_PICTURE_MIB), where=str(path))
    if image_wh is not None and picture.shape != image_wh[::-1]:
        height, width = picture.shape
        raise UserError(f"{path} is {width}x{height} pixels, but the camera's pictures are {image_wh[0]}x{image_wh[1]}.")
    return np.asarray(picture / np.float32(np.iinfo(picture.dtype).max), np.float32)


def find_dataset(folder: Path, summary: Json, given: Dataset | Path | None) -> Dataset | None:
    """Return the given dataset of a result, or the one that the result names; None if that no longer exists.

    Parameters
    ----------
    folder, summary : Path, Json
        Folder of the result, and its ``result.json``.
    given : Dataset, path or None
        Dataset of the result, or its folder.

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
    """Raise a UserError if a result was not made from a dataset, by the hash of its manifest.

    Parameters
    ----------
    dataset_sha256, scene : str
        Values of the result.
    where : Path or str
        Location of the result, for the message.
    dataset : Dataset
        The dataset.
    """
    if dataset_sha256 != dataset.sha256:
        raise UserError(
            f"{where} was not reconstructed from {dataset.folder} as it is now (its scene was {scene!r}); "
            "give the dataset that the result was made from, or reconstruct again."
        )
